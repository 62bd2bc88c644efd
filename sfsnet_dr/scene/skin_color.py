"""From skin spectra to linear Rec. 709, and the individual typology angle that grades skin tones."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfsnet_dr.base.color import LUMINANCE, linear_to_lab, reflectance_weights
from sfsnet_dr.scene.skin_optics import WAVELENGTHS

Array = NDArray[np.float64]

#: Least linear value of a skin colour: the spectra of dark skin reach -.001 in blue, outside Rec. 709.
GAMUT_FLOOR: Final = 0.004


def skin_rgb(reflectance: ArrayLike, floor: float | None = GAMUT_FLOOR) -> Array:
    """Linear Rec. 709 of reflectance spectra under D65, CIE 1931 2 degrees.

    Args:
        reflectance: (..., 31) at ``WAVELENGTHS``.
        floor: see :func:`into_gamut`; None leaves the colours as they are.

    Returns:
        (..., 3).
    """
    linear = np.asarray(np.asarray(reflectance, dtype=np.float64) @ _weights())
    return linear if floor is None else into_gamut(linear, floor)


def into_gamut(linear: ArrayLike, floor: float = GAMUT_FLOOR) -> Array:
    """Move colours (..., 3) toward the grey of their luminance until no channel is below ``floor``.

    Luminance is kept, hue nearly; only chroma falls. A colour whose luminance is itself below the floor
    becomes the grey of the floor.
    """
    colours = np.asarray(linear, dtype=np.float64)
    grey = np.maximum(colours @ LUMINANCE, floor)[..., None]
    lowest = colours.min(axis=-1, keepdims=True)
    reach = np.where(lowest < floor, (grey - floor) / np.maximum(grey - lowest, 1e-12), 1.0)
    return np.asarray(np.maximum(grey + reach * (colours - grey), floor))


def typology_angle(linear: ArrayLike) -> Array:
    """Individual typology angle, degrees, of linear colours (..., 3) (Chardon, Cretois, Hourseau 1991).

    ITA = atan((L* - 50) / b*). Above 55 is very light, 41 light, 28 intermediate, 10 tan, -30 brown, below
    that dark.
    """
    lab = linear_to_lab(linear)
    return np.asarray(np.degrees(np.arctan2(lab[..., 0] - 50.0, lab[..., 2])))


@cache
def _weights() -> Array:
    return reflectance_weights(WAVELENGTHS)
