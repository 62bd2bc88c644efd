"""Lights as photographs of faces have them: drawn from a fitted mixture, then made a light that can exist.

A light fitted to a face is nine numbers a colour, and the environment with just these is negative somewhere
as a rule. Shadows need an environment without negative parts, so the nearest such one is taken: soft lobes
all around with powers of at least 0, whose shading of visible normals comes closest to the drawn one.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.conventions import LIGHT_ORDER, LIGHT_SIZE
from sfsnet_dr.scene.equirect import MAP_SIZE
from sfsnet_dr.scene.lights import SceneLight
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.icosphere import icosphere
from sfsnet_dr.sh.kernel import band_of, clamped_cosine
from sfsnet_dr.sh.light_mixture import FITTED, VISIBLE, LightMixture, read_mixture
from sfsnet_dr.sh.priors import Lobe, lobe_bands
from sfsnet_dr.sh.projection import equirect_directions

Array = npt.NDArray[np.float64]

#: Division of the sphere into lobes (162, about 16 degrees apart), and their sharpness (16 degrees wide).
_LEVEL: Final = 2
_SHARPNESS: Final = 12.0
#: Weight of the powers' squares: of all lights that shade alike the most even one is taken.
_EVEN: Final = 1e-3


def draw_fitted(rng: np.random.Generator, mixture: str | None = None) -> SceneLight:
    """A light of the mixture in a file, the package's own if none is given.

    Raises:
        BadInput: for a missing or damaged file.
    """
    return possible_light(_mixture(Path(mixture) if mixture else FITTED).sample(rng))


def possible_light(shading: Array) -> SceneLight:
    """The light without negative parts that shades visible normals most like shading coefficients (27,)."""
    return SceneLight("fitted", (_maps() @ lobe_powers(shading)).reshape(*MAP_SIZE, 3))


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
