"""Order-n Lambertian shading in NumPy float64, the reference of all backends, and their shapes.

Source: Sengupta et al., CVPR 2018, eq. 1 and the appendix on spherical harmonics, with the clamped-cosine
factors already inside the light (shading coefficients), as ``sh.coefficients.Shading`` holds them.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.conventions import NORMAL_EPSILON
from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.sh.basis import sh_basis

COLOURS: Final = 3

#: Numbers that an image batch may hold in one call: indices of 32 bits reach no further.
MAX_ELEMENTS: Final = 2**31 - 1


class RenderSizes(NamedTuple):
    """What the shapes of one call to a shading model say."""

    batch: int
    height: int
    width: int
    order: int


def light_order(light: Any, max_order: int) -> int:
    """The SH order of flat shading coefficients, from their count 3 (order + 1)^2.

    Args:
        light: anything with a ``shape``, (B, 3K).
        max_order: highest order that the caller can evaluate.

    Raises:
        InputError: if the count belongs to no order from 0 to ``max_order``.
    """
    count = check_shape("light", light, "B N")["N"]
    order = math.isqrt(max(count, 0) // COLOURS) - 1
    if not 0 <= order <= max_order or COLOURS * (order + 1) ** 2 != count:
        allowed = ", ".join(str(COLOURS * (o + 1) ** 2) for o in range(max_order + 1))
        raise InputError(f"light: {count} coefficients an image found, one of {allowed} expected (3 colours)")
    return order


def render_sizes(normal: Any, light: Any, albedo: Any | None = None, *, max_order: int) -> RenderSizes:
    """Check the shapes of one call and find the batch size that they broadcast to.

    Args:
        normal: (B, 3, H, W) or (1, 3, H, W).
        light: (B, 3K) or (1, 3K).
        albedo: (B, 3, H, W), (1, 3, H, W) or nothing.
        max_order: highest SH order that the caller can evaluate.

    Raises:
        InputError: naming the argument whose shape does not fit.
    """
    sizes = check_shape("normal", normal, "B 3 H W")
    height, width = sizes["H"], sizes["W"]
    order = light_order(light, max_order)
    batches = {"normal": sizes["B"], "light": int(light.shape[0])}
    if albedo is not None:
        batches["albedo"] = check_shape("albedo", albedo, "B 3 H W", H=height, W=width)["B"]
    if 0 in (*batches.values(), height, width):
        raise InputError(f"normal: shape {tuple(normal.shape)} found, no empty dimension or batch allowed")
    batch = max(batches.values())
    for name, size in batches.items():
        if size not in (1, batch):
            shape = tuple({"normal": normal, "light": light, "albedo": albedo}[name].shape)
            raise InputError(f"{name}: shape {shape} found, a batch of {batch} or of 1 expected")
    if COLOURS * batch * height * width > MAX_ELEMENTS:
        raise InputError(
            f"normal: {batch} images of {height} x {width} found, at most {MAX_ELEMENTS} numbers "
            "(3 a pixel) are allowed in one call; split the batch"
        )
    return RenderSizes(batch, height, width, order)


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
        InputError: naming the argument whose shape does not fit.
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
        InputError: naming the argument whose shape does not fit.
    """
    render_sizes(np.asarray(normal), np.asarray(light), np.asarray(albedo), max_order=MAX_ORDER)
    return np.asarray(albedo, dtype=np.float64) * shading(normal, light)
