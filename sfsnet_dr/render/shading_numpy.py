"""Order-n Lambertian shading in NumPy float64: the oracle of the other two forms.

Source: Sengupta et al., CVPR 2018, eq. 1 and the appendix on spherical harmonics, with the clamped-cosine
factors already inside the light (shading coefficients), as ``sh.coefficients.Shading`` holds them.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.conventions import NORMAL_EPSILON
from sfsnet_dr.render.shading_inputs import COLOURS, render_sizes
from sfsnet_dr.sh.basis import sh_basis

Array = npt.NDArray[np.float64]

#: Highest SH order of the NumPy form.
MAX_ORDER: Final = 8


def unit(vectors: npt.ArrayLike) -> Array:
    """Normalise vectors along their last axis: n / sqrt(max(|n|^2, 1e-12)), shape (..., 3), any length."""
    v = np.asarray(vectors, dtype=np.float64)
    v = v / np.maximum(np.abs(v).max(axis=-1, keepdims=True), 1)  # else |n|^2 overflows where n is long
    squared = np.sum(v * v, axis=-1, keepdims=True)
    return np.asarray(v / np.sqrt(np.maximum(squared, NORMAL_EPSILON)), dtype=np.float64)


def shading(normal: npt.ArrayLike, light: npt.ArrayLike) -> Array:
    """Shading S = Y(n)^T L of each colour, unclamped.

    Convention: camera frame; basis order of ``sh.basis``; light 9 R, 9 G, 9 B at order 2.

    Args:
        normal: (B, 3, H, W), any length: they are normalised here.
        light: shading coefficients (B, 3K), K = (order + 1)^2, order 0 to 8. A batch of 1 broadcasts.

    Returns:
        (B, 3, H, W) float64, linear; a constant environment of radiance 1 gives 1.

    Raises:
        BadInput: naming the argument whose shape does not fit.
    """
    sizes = render_sizes(np.asarray(normal), np.asarray(light), max_order=MAX_ORDER)
    n, flat = np.asarray(normal, dtype=np.float64), np.asarray(light, dtype=np.float64)
    basis = sh_basis(unit(np.moveaxis(n, 1, -1)), sizes.order)
    coefficients = flat.reshape(flat.shape[0], COLOURS, -1)
    return np.asarray(np.einsum("bhwk,bck->bchw", basis, coefficients), dtype=np.float64)


def f_render(normal: npt.ArrayLike, albedo: npt.ArrayLike, light: npt.ArrayLike) -> Array:
    """The paper's f_render: image = albedo * S(normal, light), linear and unclamped.

    Args:
        normal: (B, 3, H, W), any length.
        albedo: (B, 3, H, W), linear.
        light: shading coefficients (B, 3K), order 0 to 8. A batch of 1 broadcasts.

    Returns:
        (B, 3, H, W) float64.

    Raises:
        BadInput: naming the argument whose shape does not fit.
    """
    render_sizes(np.asarray(normal), np.asarray(light), np.asarray(albedo), max_order=MAX_ORDER)
    return np.asarray(albedo, dtype=np.float64) * shading(normal, light)
