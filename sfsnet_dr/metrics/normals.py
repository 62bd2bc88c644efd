"""Errors of normals, in degrees, as tables of face shape report them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class NormalErrors:
    """Angles between two normal maps over the pixels of a mask.

    Attributes:
        mean: degrees.
        std: standard deviation over the pixels, degrees.
        below20: percentage of pixels with an angle below 20 degrees, 0 to 100.
        below25: the same for 25 degrees.
        below30: the same for 30 degrees.
        pixels: number of pixels counted.
    """

    mean: float
    std: float
    below20: float
    below25: float
    below30: float
    pixels: int


def angles_deg(a: npt.ArrayLike, b: npt.ArrayLike) -> Array:
    """Angle between vectors (..., 3) of any non-zero length, degrees, 0 to 180, accurate near 0 and 180.

    atan2(|a x b|, a . b) is used because an arc cosine loses half of the digits for small angles. A zero
    vector has no direction: its angle is 0 by this formula, so leave such pixels out.
    """
    u, v = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    across = np.linalg.norm(np.cross(u, v), axis=-1)
    return np.asarray(np.degrees(np.arctan2(across, np.sum(u * v, axis=-1))), dtype=np.float64)


def angular_error_deg(a: npt.ArrayLike, b: npt.ArrayLike, mask: npt.ArrayLike) -> NormalErrors:
    """Statistics of the angle between two normal maps.

    Args:
        a: (..., 3), any non-zero length within the mask.
        b: (..., 3), likewise.
        mask: (...); pixels above 1/2 are counted.

    Raises:
        InputError: for shapes that do not fit, an empty mask, or a zero, NaN or infinite normal inside it.
    """
    u, v = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    chosen = np.asarray(mask) > 0.5
    for name, array in (("a", u), ("b", v)):
        if array.shape != (*chosen.shape, 3):
            raise InputError(
                f"{name}: shape {array.shape} found, {(*chosen.shape, 3)} expected as of the mask"
            )
        length = np.linalg.norm(array[chosen], axis=-1)
        if not (np.isfinite(length) & (length > 0)).all():
            raise InputError(f"{name}: a zero, NaN or infinite normal found inside the mask")
    if not chosen.any():
        raise InputError("mask: no pixel above 1/2 found, at least one expected")
    angle = angles_deg(u[chosen], v[chosen])
    below20, below25, below30 = (100 * float(np.mean(angle < limit)) for limit in (20, 25, 30))
    return NormalErrors(float(angle.mean()), float(angle.std()), below20, below25, below30, int(angle.size))
