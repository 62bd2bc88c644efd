"""Random natural-looking light: an ambient dome with a vertical gradient, and one to three soft lobes.

The light is never negative, so that it is a light a scene could have, and it is known in closed form in both
domains: as radiance over directions, for a path tracer, and as coefficients, for the shading models.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfsnet_dr.core.color import LUMINANCE, blackbody_tint
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.sh.basis import basis_index, sh_basis
from sfsnet_dr.sh.coefficients import Radiance
from sfsnet_dr.sh.kernel import MAX_ORDER, band_of
from sfsnet_dr.sh.projection import equirect_directions

#: Colour temperatures of lamps and sky, kelvin.
TEMPERATURES = (2800.0, 10000.0)
#: Sharpness of a lobe: 2 is half the sky, 40 a softbox of about 9 degrees standard deviation.
SHARPNESS = (2.0, 40.0)
#: Shading (luminance) of a surface that faces the viewer.
FRONTAL_SHADING = (0.7, 1.1)
#: Share of that shading that the ambient dome gives.
AMBIENT_SHARE = (0.15, 0.6)
#: Mean of the normal distribution that lobe directions come from: above the viewer, in front of the face.
_LOBE_CENTRE = np.array([0.0, 0.35, 0.8])
#: Least z of the first lobe. If all stood behind the face, exposing for its front would flood its rim.
_KEY_LEAST_Z = 0.3
_FRONT = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Lobe:
    """A von Mises-Fisher lobe: radiance power * kappa / (4 pi sinh kappa) * exp(kappa cos(angle)).

    Attributes:
        direction: (3,) unit vector toward the light.
        kappa: sharpness, above 0.
        power: (3,) linear RGB, at least 0: radiance integrated over the sphere, i.e. the irradiance of a
            surface facing a lobe of infinite sharpness.
    """

    direction: NDArray[np.float64]
    kappa: float
    power: NDArray[np.float64]

    def radiance(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Radiance (..., 3) from unit directions (..., 3)."""
        cosine = directions @ self.direction
        peak = self.kappa / (2 * np.pi * -np.expm1(-2 * self.kappa))
        return np.asarray((peak * np.exp(self.kappa * (cosine - 1)))[..., None] * self.power)

    def coefficients(self, order: int) -> NDArray[np.float64]:
        """(K, 3): those of a delta light, each band narrowed by ``lobe_bands``."""
        return np.outer(lobe_bands(self.kappa, order) * sh_basis(self.direction, order), self.power)


@dataclass(frozen=True, eq=False)
class LobeLight:
    """An environment: ambient * (1 + gradient * y) plus lobes.

    Attributes:
        ambient: (3,) linear RGB radiance at the horizon, at least 0.
        gradient: -1 to 1; positive is brighter above.
        lobes: soft lights.

    Raises:
        InputError: if some direction would have negative radiance.
    """

    ambient: NDArray[np.float64]
    gradient: float
    lobes: tuple[Lobe, ...]

    def __post_init__(self) -> None:
        if not -1 <= self.gradient <= 1:
            raise InputError(
                f"gradient: {self.gradient} found, -1 to 1 allowed so that no radiance is negative"
            )
        if not (np.all(self.ambient >= 0) and all(np.all(lobe.power >= 0) for lobe in self.lobes)):
            raise InputError(
                "light: a negative or NaN ambient or lobe colour found, values of at least 0 allowed"
            )
        if not all(lobe.kappa > 0 for lobe in self.lobes):
            raise InputError("light: a lobe's kappa is not positive; use the ambient term for uniform light")

    def radiance(self, directions: ArrayLike) -> NDArray[np.float64]:
        """Radiance (..., 3), linear RGB, that arrives from unit directions (..., 3)."""
        vectors = np.asarray(directions, dtype=np.float64)
        total = (1 + self.gradient * vectors[..., 1:2]) * self.ambient
        return total + sum(lobe.radiance(vectors) for lobe in self.lobes)

    def coefficients(self, order: int) -> Radiance:
        """Radiance coefficients to an order, in closed form."""
        values = np.zeros(((order + 1) ** 2, 3))
        values[0] = np.sqrt(4 * np.pi) * self.ambient
        if order >= 1:
            values[basis_index(1, 1, odd=True)] = np.sqrt(4 * np.pi / 3) * self.gradient * self.ambient
        return Radiance(values + sum(lobe.coefficients(order) for lobe in self.lobes))

    def equirect(self, height: int, width: int) -> NDArray[np.float64]:
        """Environment map (H, W, 3) in the convention of ``sfsnet_dr.sh.projection``."""
        return self.radiance(equirect_directions(height, width))

    def scaled(self, factor: float) -> LobeLight:
        """The same light, brighter or darker by a factor of at least 0."""
        lobes = tuple(replace(lobe, power=lobe.power * factor) for lobe in self.lobes)
        return LobeLight(self.ambient * factor, self.gradient, lobes)


def lobe_bands(kappa: float, order: int) -> NDArray[np.float64]:
    """(K,): share of each coefficient of a delta light that a lobe has, I_(l+1/2)(kappa) / I_(1/2)(kappa)."""
    from scipy.special import ive

    bands = np.arange(order + 1) + 0.5
    return np.asarray((ive(bands, kappa) / ive(0.5, kappa))[band_of(order)])


def sample_lights(rng: np.random.Generator, count: int) -> list[LobeLight]:
    """Draw lights, exposed so that a surface facing the viewer has a shading of 0.7 to 1.1 (luminance).

    Each has its own ambient tint and gradient, 1 to 3 lobes of their own tint (2800 to 10000 K) and sharpness
    (2 to 40, log-uniform), more often in front and above than behind; the first is always in front.

    Args:
        rng: the only source of randomness; equal generators give equal lights.
        count: how many.
    """
    return [_sample_light(rng) for _ in range(count)]


def frontal_shading(light: LobeLight) -> float:
    """Luminance of a convex white Lambertian surface with normal +z, by the order-8 expansion."""
    return float(light.coefficients(MAX_ORDER).to_shading().evaluate(_FRONT) @ LUMINANCE)


def _sample_light(rng: np.random.Generator) -> LobeLight:
    ambient = LobeLight(_sample_tint(rng), rng.uniform(-0.4, 0.9), ())
    key, others = _sample_lobe(rng, _KEY_LEAST_Z), [_sample_lobe(rng) for _ in range(rng.integers(0, 3))]
    lobes = LobeLight(np.zeros(3), 0.0, (key, *others))
    exposure, share = rng.uniform(*FRONTAL_SHADING), rng.uniform(*AMBIENT_SHARE)
    ambient = ambient.scaled(exposure * share / frontal_shading(ambient))
    lobes = lobes.scaled(exposure * (1 - share) / frontal_shading(lobes))
    return LobeLight(ambient.ambient, ambient.gradient, lobes.lobes)


def _sample_lobe(rng: np.random.Generator, least_z: float = -1.0) -> Lobe:
    direction = _sample_direction(rng)
    while direction[2] < least_z:
        direction = _sample_direction(rng)
    kappa = float(np.exp(rng.uniform(*np.log(SHARPNESS))))
    return Lobe(direction, kappa, rng.uniform(0.3, 1.0) * _sample_tint(rng))


def _sample_direction(rng: np.random.Generator) -> NDArray[np.float64]:
    vector = _LOBE_CENTRE + rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def _sample_tint(rng: np.random.Generator) -> NDArray[np.float64]:
    """Colour of luminance 1; temperatures are drawn evenly in 1/T, in which the eye sees even steps."""
    low, high = 1 / TEMPERATURES[1], 1 / TEMPERATURES[0]
    return blackbody_tint(1 / rng.uniform(low, high))
