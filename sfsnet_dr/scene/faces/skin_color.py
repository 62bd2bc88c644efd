"""Skin spectra to linear Rec. 709, a table of skin colours, and the individual typology angle.

The table spans melanin, blood, saturation and thickness. A person has one thickness, so that the table is cut
to three axes first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfsnet_dr.core.color import LUMINANCE, linear_to_lab, reflectance_weights
from sfsnet_dr.scene.faces.skin_optics import WAVELENGTHS, skin_reflectance

Array = NDArray[np.float64]

#: Least linear value of a skin colour: the spectra of dark skin reach -0.001 in blue, outside Rec. 709.
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
    return linear if floor is None else clip_to_gamut(linear, floor)


def clip_to_gamut(linear: ArrayLike, floor: float = GAMUT_FLOOR) -> Array:
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


MELANIN: Final = np.geomspace(0.003, 0.6, 60)
BLOOD: Final = np.geomspace(0.001, 0.08, 32)
SATURATION: Final = np.linspace(0.4, 0.95, 4)
THICKNESS: Final = np.linspace(0.004, 0.025, 15)


@dataclass(frozen=True, eq=False)
class SkinTable:
    """Linear colours over melanin, blood and saturation for one thickness of the epidermis.

    Attributes:
        colours: (60, 32, 4, 3).
    """

    colours: NDArray[np.float32]

    def look_up(self, melanin: Array, blood: Array, saturation: Array) -> Array:
        """(V, 3) linear Rec. 709 by trilinear interpolation; values off the table's ends take the end.

        Args:
            melanin, blood, saturation: (V,) each.
        """
        axes = [
            _place(np.log(melanin), np.log(MELANIN)),
            _place(np.log(blood), np.log(BLOOD)),
            _place(saturation, SATURATION),
        ]
        strides = (len(BLOOD) * len(SATURATION), len(SATURATION), 1)
        flat = self.colours.reshape(-1, 3)
        start = sum(index * stride for (index, _), stride in zip(axes, strides, strict=True))
        total = np.zeros((len(melanin), 3), dtype=np.float32)
        for corner in np.ndindex(2, 2, 2):
            weight = np.ones(len(melanin), dtype=np.float32)
            offset = 0
            for high, (_, part), stride in zip(corner, axes, strides, strict=True):
                weight *= part if high else 1.0 - part
                offset += high * stride
            total += weight[:, None] * flat[start + offset]
        return total.astype(np.float64)


def skin_table(thickness: float) -> SkinTable:
    """The table for an epidermis of the given thickness in cm."""
    index, part = _place(np.array([thickness]), THICKNESS)
    table, k, t = _full_table(), int(index[0]), float(part[0])
    return SkinTable(((1.0 - t) * table[k] + t * table[k + 1]).astype(np.float32))


def melanin_for(angle: float, blood: float, saturation: float, thickness: float) -> float:
    """The melanin fraction that gives skin a typology angle in degrees; the nearest there is, if none does.

    The angle falls as melanin grows, so that the relation can be turned round by interpolation.
    """
    angles = _angles(blood, saturation, thickness)
    return float(np.exp(np.interp(-angle, -angles, np.log(MELANIN))))


def lightest_angle(blood: float, saturation: float, thickness: float) -> float:
    """The typology angle at the least melanin of the table."""
    return float(_angles(blood, saturation, thickness)[0])


def _angles(blood: float, saturation: float, thickness: float) -> Array:
    return typology_angle(skin_rgb(skin_reflectance(MELANIN, blood, saturation, thickness)))


@cache
def _full_table() -> Array:
    """(15, 60, 32, 4, 3), thickness first."""
    grid = np.meshgrid(THICKNESS, MELANIN, BLOOD, SATURATION, indexing="ij")
    thickness, melanin, blood, saturation = grid
    return skin_rgb(skin_reflectance(melanin, blood, saturation, thickness))


def _place(value: Array, nodes: Array) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Cell and position in it, in [0, 1], of values on equally spaced nodes."""
    position = (value - nodes[0]) / (nodes[1] - nodes[0])
    position = np.clip(position, 0.0, len(nodes) - 1.0)
    index = np.minimum(position.astype(np.intp), len(nodes) - 2)
    return index, (position - index).astype(np.float32)
