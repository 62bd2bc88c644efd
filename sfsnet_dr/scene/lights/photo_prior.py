"""Lights as photographs have them: draws from a Gaussian mixture over fitted coefficients.

The numbers live in a small JSON file, so that what was learnt from photographs travels without them.
Coefficients are in units in which a face's mean shading (``metered``) has the luminance 1.

A light fitted to a face is nine numbers a colour, and the environment with just these is negative somewhere
as a rule. Shadows need an environment without negative parts, so the nearest such one is taken: soft lobes
all around with powers of at least 0, whose shading of visible normals comes closest to the drawn one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.conventions import LIGHT_ORDER, LIGHT_SIZE
from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.core.files import write_text
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.lights.vmf_lobes import Lobe, lobe_bands
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.icosphere import icosphere
from sfsnet_dr.sh.kernel import band_of, clamped_cosine
from sfsnet_dr.sh.projection import equirect_directions

Array = npt.NDArray[np.float64]

#: The mixture that comes with the package.
FITTED: Final = Path(__file__).with_name("fitted_lights.json")

#: Greatest angle from the viewer's direction of normals that count as visible, degrees.
VISIBLE: Final = 70.0

_FORMAT: Final = "sfsnet_dr.light_mixture.1"
_MOST_DRAWS: Final = 1000


@dataclass(frozen=True, eq=False)
class LightMixture:
    """K components over lights of 27 numbers (9 R, 9 G, 9 B shading coefficients).

    Attributes:
        shares: probability of each component, (K,); they sum to 1.
        means: (K, 27).
        factors: lower triangular roots of the covariances, (K, 27, 27).
        source: what it was learnt from, for people to read: how many photographs, residuals.
    """

    shares: Array
    means: Array
    factors: Array
    source: Mapping[str, Any]

    def __post_init__(self) -> None:
        sizes = check_shape("shares", self.shares, "K")
        check_shape("means", self.means, f"K {LIGHT_SIZE}", **sizes)
        check_shape("factors", self.factors, f"K {LIGHT_SIZE} {LIGHT_SIZE}", **sizes)
        finite = all(np.isfinite(part).all() for part in (self.shares, self.means, self.factors))
        if not finite or (self.shares < 0).any() or abs(float(self.shares.sum()) - 1) > 1e-6:
            raise InputError("mixture: shares from 0 on that sum to 1, finite means and factors are needed")

    @property
    def digest(self) -> str:
        """Hash of the numbers; the same for the same distribution."""
        parts = (self.shares, self.means, self.factors)
        return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()[
            :16
        ]

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Lights (count, 27) as the mixture has them, physically possible or not."""
        component = rng.choice(len(self.shares), size=count, p=self.shares / self.shares.sum())
        noise = rng.normal(size=(count, LIGHT_SIZE))
        return np.asarray(self.means[component] + np.einsum("nij,nj->ni", self.factors[component], noise))

    def sample(self, rng: np.random.Generator) -> Array:
        """A light (27,) that shades no visible normal negatively; others are drawn again.

        Raises:
            InputError: if a thousand draws gave none.
        """
        for _ in range(_MOST_DRAWS):
            light = self.draw(rng, 1)[0]
            if lights_visibly(light[None])[0]:
                return np.asarray(light)
        raise InputError(f"mixture: none of {_MOST_DRAWS} lights is positive on visible normals; fit it anew")

    def moments(self) -> tuple[Array, Array]:
        """Mean (27,) and covariance (27, 27) of the whole."""
        mean = self.shares @ self.means
        apart = self.means - mean
        within = np.einsum("k,kij,klj->il", self.shares, self.factors, self.factors)
        return mean, within + np.einsum("k,ki,kj->ij", self.shares, apart, apart)


def lights_visibly(lights: Array) -> npt.NDArray[np.bool_]:
    """Whether lights (N, 27) shade no normal within ``VISIBLE`` degrees of the viewer negatively, (N,)."""
    directions = icosphere(3)
    near = directions[directions[:, 2] >= np.cos(np.radians(VISIBLE))]
    shading = lights.reshape(-1, 3, LIGHT_SIZE // 3) @ sh_basis(near, LIGHT_ORDER).T
    return np.asarray((shading >= 0).all(axis=(1, 2)))


def write_mixture(path: Path | str, mixture: LightMixture) -> None:
    """Write a mixture with five digits; of the factors the lower triangles row by row."""
    rows, columns = np.tril_indices(LIGHT_SIZE)
    plain = {
        "format": _FORMAT,
        "source": dict(mixture.source),
        "shares": [float(share) for share in mixture.shares],
        "means": [_rounded(mean) for mean in mixture.means],
        "factors": [_rounded(factor[rows, columns]) for factor in mixture.factors],
    }
    lines = ",\n".join(f"{json.dumps(key)}: {_lines(value)}" for key, value in plain.items())
    write_text(path, "{\n" + lines + "\n}\n")


def read_mixture(path: Path | str = FITTED) -> LightMixture:
    """Read what ``write_mixture`` wrote.

    Raises:
        InputError: for a missing or damaged file, or one of another format.
    """
    rows, columns = np.tril_indices(LIGHT_SIZE)
    try:
        plain = json.loads(Path(path).read_text(encoding="utf-8"))
        if plain["format"] != _FORMAT:
            raise ValueError(f"format {plain['format']!r}")
        shares = np.array(plain["shares"], np.float64)
        factors = np.zeros((len(shares), LIGHT_SIZE, LIGHT_SIZE))
        factors[:, rows, columns] = plain["factors"]
        return LightMixture(shares, np.array(plain["means"], np.float64), factors, plain["source"])
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; `sfsnet-dr fit-light-prior` writes one") from error
    except (OSError, ValueError, KeyError, TypeError, InputError) as error:
        raise InputError(f"{path}: no mixture of lights ({error}); {_FORMAT} is needed") from error


def _rounded(values: Array) -> list[float]:
    return [float(f"{value:.5g}") for value in values]


def _lines(value: object) -> str:
    if isinstance(value, list) and value and isinstance(value[0], list):
        return "[\n" + ",\n".join(json.dumps(row) for row in value) + "\n]"
    return json.dumps(value)


#: Division of the sphere into lobes (162, about 16 degrees apart), and their sharpness (16 degrees wide).
_LEVEL: Final = 2
_SHARPNESS: Final = 12.0
#: Weight of the powers' squares: of all lights that shade alike the most even one is taken.
_EVEN: Final = 1e-3


def draw_photo_light(rng: np.random.Generator, mixture: str | None = None) -> Light:
    """A light of the mixture in a file, the package's own if none is given.

    Raises:
        InputError: for a missing or damaged file.
    """
    return possible_light(_mixture(Path(mixture) if mixture else FITTED).sample(rng))


def possible_light(shading: Array) -> Light:
    """The light without negative parts that shades visible normals most like shading coefficients (27,)."""
    return Light("fitted", (_maps() @ lobe_powers(shading)).reshape(*MAP_SIZE, 3))


def lobe_powers(shading: Array) -> Array:
    """Powers (162, 3), at least 0, of the lobes of ``possible_light``."""
    from scipy.optimize import nnls

    matrix = np.concatenate([_root() @ _lobe_shading(), _EVEN * np.eye(_lobe_shading().shape[1])])
    columns = []
    for wanted in shading.reshape(3, LIGHT_SIZE // 3):
        right = np.concatenate([_root() @ wanted, np.zeros(matrix.shape[1])])
        columns.append(nnls(matrix, right, maxiter=10 * matrix.shape[1])[0])
    return np.stack(columns, axis=1)


@cache
def _mixture(path: Path) -> LightMixture:
    return read_mixture(path)


@cache
def _lobe_shading() -> Array:
    """(9, 162) shading coefficients of lobes of power 1."""
    factors = (clamped_cosine(LIGHT_ORDER) / np.pi)[band_of(LIGHT_ORDER)] * lobe_bands(
        _SHARPNESS, LIGHT_ORDER
    )
    return np.asarray((sh_basis(icosphere(_LEVEL), LIGHT_ORDER) * factors).T)


@cache
def _root() -> Array:
    """(9, 9) R with |R d|^2 the mean square over visible normals of a difference of shading d."""
    normals = icosphere(3)
    visible = normals[normals[:, 2] >= np.cos(np.radians(VISIBLE))]
    return np.asarray(np.linalg.qr(sh_basis(visible, LIGHT_ORDER) / np.sqrt(len(visible)), mode="r"))


@cache
def _maps() -> Array:
    """(H * W, 162) radiance of lobes of power 1."""
    texels, white = equirect_directions(*MAP_SIZE), np.ones(1)
    lobes = [Lobe(direction, _SHARPNESS, white) for direction in icosphere(_LEVEL)]
    return np.stack([lobe.radiance(texels).ravel() for lobe in lobes], axis=1)
