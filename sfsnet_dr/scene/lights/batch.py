"""Lights of a bank put before a batch of faces: turned, made hard or soft, white-balanced and exposed.

The batch form of ``scene.light_sources.sample_scene_light``, on coefficients in place of maps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.conventions import LIGHT_ORDER
from sfsnet_dr.scene.lights.cache import LightCache
from sfsnet_dr.scene.lights.light import MAP_ORDER, SNAP_DEG, SOFT_KAPPA, face_normals
from sfsnet_dr.scene.lights.sampling import LARGEST_TILT
from sfsnet_dr.scene.lights.spec import LightSpec
from sfsnet_dr.scene.lights.vmf_lobes import lobe_bands
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.kernel import band_of, clamped_cosine
from sfsnet_dr.sh.rotation import rotate_each

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Lighting:
    """The lights of a batch of B faces.

    Attributes:
        radiance: coefficients of order 4 for transport and gloss, (B, 25, 3).
        irradiance: of the D directional responses, (B, D, 3).
        label: order-2 shading coefficients of all light together, (B, 9, 3).
        level: mean shading of a white face, (B, 3).
    """

    radiance: Array
    irradiance: Array
    label: Array
    level: Array

    def part(self, which: slice) -> Lighting:
        """The lights of some of the faces."""
        return Lighting(self.radiance[which], self.irradiance[which], self.label[which], self.level[which])


def light_faces(rng: np.random.Generator, bank: LightCache, directions: Array, spec: LightSpec) -> Lighting:
    """Draw a light for each face.

    Lamps of a studio come from directions that the face has a response to. Surroundings with a sun are turned
    about the vertical and tilted by at most ``LARGEST_TILT`` until it shines from one; what is hard beside it
    becomes soft unless it lies within ``SNAP_DEG`` degrees of one too.

    Args:
        rng: the only source of randomness.
        bank: the lights.
        directions: unit vectors of the faces' directional responses, (B, D, 3); D may be 0.
        spec: ranges of exposure and white balance.
    """
    count = len(directions)
    picks = rng.integers(len(bank), size=count)
    radiance, toward, power = bank.radiance[picks], bank.toward[picks], bank.power[picks]
    places, turns = _places(rng, toward, power, bank.free[picks], directions)
    turned = np.einsum("bij,bmj->bmi", turns, toward)
    places = _snapped(places, turned, power, directions)
    radiance = rotate_each(radiance, turns) + _softened(turned, power * (places < 0)[..., None])
    hard = (places[..., None] == np.arange(directions.shape[1])).astype(float)
    irradiance = np.einsum("bmd,bmc->bdc", hard, power)
    return _as_a_camera(rng, radiance, irradiance, directions, spec)


def _places(
    rng: np.random.Generator, toward: Array, power: Array, free: npt.NDArray[np.bool_], directions: Array
) -> tuple[npt.NDArray[np.intp], Array]:
    """Index of the direction (B, M) that each lamp is given, -1 for none, and each light's turn (B, 3, 3)."""
    count, known = directions.shape[:2]
    places = np.full((count, power.shape[1]), -1)
    turns = np.tile(np.eye(3), (count, 1, 1))
    if not known:
        return places, turns
    lit = np.asarray(power.any(axis=-1))
    chance = rng.random((count, known))
    first = min(known, places.shape[1])
    places[:, :first] = np.where(free[:, None] & lit[:, :first], chance.argsort(axis=1)[:, :first], -1)
    fitting = np.abs(_height(directions) - _height(toward[:, :1])) <= np.radians(LARGEST_TILT)
    turned = ~free & lit[:, 0] & fitting.any(axis=1)
    chosen = (chance * fitting).argmax(axis=1)
    target = np.take_along_axis(directions, chosen[:, None, None], axis=1)[:, 0]
    turns[turned] = turns_to(toward[turned, 0], target[turned])
    places[turned, 0] = chosen[turned]
    return places, turns


def _snapped(
    places: npt.NDArray[np.intp], toward: Array, power: Array, directions: Array
) -> npt.NDArray[np.intp]:
    """Lamps that have no direction yet get one within ``SNAP_DEG`` degrees."""
    if not directions.shape[1]:
        return places
    cosines = np.einsum("bmi,bdi->bmd", toward, directions)
    near = (cosines.max(axis=-1) >= np.cos(np.radians(SNAP_DEG))) & power.any(axis=-1)
    return np.where((places < 0) & near, cosines.argmax(axis=-1), places)


def _softened(toward: Array, power: Array) -> Array:
    """Coefficients (B, 25, 3) of lamps (B, M, 3) as by thin cloud (``Light.softened``)."""
    basis = sh_basis(toward, MAP_ORDER) * lobe_bands(SOFT_KAPPA, MAP_ORDER)
    return np.asarray(np.einsum("bmk,bmc->bkc", basis, power))


def _as_a_camera(
    rng: np.random.Generator, radiance: Array, irradiance: Array, directions: Array, spec: LightSpec
) -> Lighting:
    """White balance and exposure, as ``Light.balanced`` and ``exposed`` do."""
    strength = rng.uniform(*spec.white_balance, (len(radiance), 1))
    low, high = np.log(spec.exposure)
    exposure = np.exp(rng.uniform(low, high, (len(radiance), 1)))
    mean = _face_shading(radiance, irradiance, directions)
    level = (mean @ LUMINANCE)[:, None]
    gain = np.minimum(level / np.maximum(mean, level / 4), 4.0) ** strength
    gain = gain * exposure / ((mean * gain) @ LUMINANCE)[:, None]
    radiance, irradiance = radiance * gain[:, None], irradiance * gain[:, None]
    kept = (LIGHT_ORDER + 1) ** 2
    total = radiance[:, :kept] + np.einsum("bdk,bdc->bkc", sh_basis(directions, LIGHT_ORDER), irradiance)
    return Lighting(radiance, irradiance, total * _cosine_factors(LIGHT_ORDER)[:, None], mean * gain)


def _face_shading(radiance: Array, irradiance: Array, directions: Array) -> Array:
    """``Light.face_shading`` of each light, (B, 3)."""
    normals, responses = face_normals(), _face_responses()
    soft = np.maximum(np.einsum("nk,bkc->bnc", responses, radiance), 0.0).mean(axis=1)
    facing = np.maximum(directions @ normals.T, 0.0).mean(axis=-1) / np.pi
    return np.asarray(soft + np.einsum("bd,bdc->bc", facing, irradiance))


def turns_to(toward: Array, target: Array) -> Array:
    """Rotations (N, 3, 3) that take directions (N, 3) to others: about the vertical, then a tilt of the rest.

    Many of ``scene.light_sources.turn_to`` at once.
    """
    spin = _azimuth(target) - _azimuth(toward)
    zero, one = np.zeros_like(spin), np.ones_like(spin)
    cosine, sine = np.cos(spin), np.sin(spin)
    about_vertical = _matrices([[cosine, zero, sine], [zero, one, zero], [-sine, zero, cosine]])
    # The tilt is about the horizontal axis a quarter turn from the target.
    x, z = np.cos(_azimuth(target)), -np.sin(_azimuth(target))
    tilt = _height(toward) - _height(target)
    cosine, sine = np.cos(tilt), np.sin(tilt)
    about_sideways = _matrices(
        [
            [cosine + x * x * (1 - cosine), -z * sine, x * z * (1 - cosine)],
            [z * sine, cosine, -x * sine],
            [x * z * (1 - cosine), x * sine, cosine + z * z * (1 - cosine)],
        ]
    )
    return about_sideways @ about_vertical


def _matrices(entries: list[list[Array]]) -> Array:
    return np.moveaxis(np.array(entries), -1, 0)


def _azimuth(directions: Array) -> Array:
    return np.arctan2(directions[..., 0], directions[..., 2])


def _height(directions: Array) -> Array:
    return np.asarray(np.arcsin(np.clip(directions[..., 1], -1.0, 1.0)))


def _cosine_factors(order: int) -> Array:
    """A_l / pi of every coefficient."""
    return (clamped_cosine(order) / np.pi)[band_of(order)]


@cache
def _face_responses() -> Array:
    """(96, 25): shading of the normals that a camera meters under each basis light."""
    return sh_basis(face_normals(), MAP_ORDER) * _cosine_factors(MAP_ORDER)
