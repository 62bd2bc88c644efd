"""Colour in NumPy: the sRGB curve, luminance, colour differences, the tint of a black body.

Linear values are Rec. 709 primaries, white point D65. colour-science does the colorimetry; it is imported
inside the functions that need it because its import takes about a second.
"""

from __future__ import annotations

import sys
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfsnet_dr.core.errors import InputError

_PRIMARIES: Final = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]])
_D65: Final = np.array([0.3127, 0.3290])


def _xyz(chromaticity: NDArray[np.float64]) -> NDArray[np.float64]:
    """XYZ of luminance 1 for xy chromaticities (..., 2)."""
    x, y = chromaticity[..., 0], chromaticity[..., 1]
    return np.stack([x / y, np.ones_like(x), (1 - x - y) / y], axis=-1)


def _rgb_to_xyz() -> NDArray[np.float64]:
    columns = _xyz(_PRIMARIES).T
    return np.asarray(columns * np.linalg.solve(columns, _xyz(_D65)))


#: (3, 3) linear Rec. 709 to CIE XYZ (2 degrees), white = luminance 1.
RGB_TO_XYZ: Final = _rgb_to_xyz()
#: (3,) luminance of the primaries, near 0.2126, 0.7152, 0.0722.
LUMINANCE: Final = RGB_TO_XYZ[1]


def srgb_to_linear(encoded: ArrayLike) -> NDArray[np.float64]:
    """Decode sRGB values, any shape, nominally 0..1, into linear light.

    Below 0 the curve's straight piece goes on, above 1 its power piece: nothing is clipped.
    """
    return np.asarray(_colour().cctf_decoding(np.asarray(encoded, dtype=np.float64), function="sRGB"))


def linear_to_srgb(linear: ArrayLike) -> NDArray[np.float64]:
    """Encode linear light, any shape, with the sRGB curve: inverse of :func:`srgb_to_linear`, not clipped."""
    return np.asarray(_colour().cctf_encoding(np.asarray(linear, dtype=np.float64), function="sRGB"))


def luminance(linear: ArrayLike) -> NDArray[np.float64]:
    """Luminance (...) of linear colours (..., 3); white (1, 1, 1) has 1."""
    return np.asarray(_check_colours("linear", linear) @ LUMINANCE)


def linear_to_lab(linear: ArrayLike) -> NDArray[np.float64]:
    """CIE L*, a*, b* (..., 3) of linear colours (..., 3) with white (1, 1, 1)."""
    return np.asarray(_colour().XYZ_to_Lab(_check_colours("linear", linear) @ RGB_TO_XYZ.T, _D65))


def delta_e_2000(linear_a: ArrayLike, linear_b: ArrayLike) -> NDArray[np.float64]:
    """CIE Delta E 2000 (...) between linear colours (..., 3) with white (1, 1, 1); 1 is just noticeable."""
    labs = [
        linear_to_lab(_check_colours(name, linear))
        for name, linear in (("linear_a", linear_a), ("linear_b", linear_b))
    ]
    return np.asarray(_colour().delta_E(*labs, method="CIE 2000"))


def reflectance_weights(wavelengths: ArrayLike) -> NDArray[np.float64]:
    """(N, 3) weights W such that a reflectance spectrum (..., N) @ W is its linear colour in daylight.

    The CIE 1931 observer under D65, both from colour-science, resampled to the given equal steps. The
    columns are scaled so that a white of reflectance 1 is exactly (1, 1, 1), whatever the steps leave out.

    Args:
        wavelengths: (N,) in nm, increasing in equal steps.
    """
    colour, steps = _colour(), np.asarray(wavelengths, dtype=np.float64)
    shape = colour.SpectralShape(steps[0], steps[-1], steps[1] - steps[0])
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    daylight = colour.SDS_ILLUMINANTS["D65"].copy().align(shape).values
    weights = np.linalg.solve(RGB_TO_XYZ, (observer * daylight[:, None]).T).T
    return np.asarray(weights / weights.sum(axis=0))


def blackbody_tint(kelvin: float) -> NDArray[np.float64]:
    """Linear colour (3,), luminance 1, of a black body.

    Chromaticity by the cubic fits of Kang et al., "Design of advanced color temperature control system for
    HDTV applications", 2002. Colours outside the Rec. 709 gamut (below about 1900 K) are clipped at 0.

    Raises:
        InputError: outside the fits' 1667 to 25000 K.
    """
    if not 1667 <= kelvin <= 25000:
        raise InputError(f"colour temperature: {kelvin} K found, 1667 to 25000 allowed")
    chromaticity = np.array(_blackbody_xy(kelvin))
    rgb = np.maximum(np.linalg.solve(RGB_TO_XYZ, _xyz(chromaticity)), 0)
    return np.asarray(rgb / (rgb @ LUMINANCE))


def _blackbody_xy(kelvin: float) -> tuple[float, float]:
    t = 1e3 / kelvin
    if kelvin <= 4000:
        x = float(np.polyval([-0.2661239, -0.2343589, 0.8776956, 0.179910], t))
    else:
        x = float(np.polyval([-3.0258469, 2.1070379, 0.2226347, 0.240390], t))
    if kelvin <= 2222:
        return x, float(np.polyval([-1.1063814, -1.34811020, 2.18555832, -0.20219683], x))
    if kelvin <= 4000:
        return x, float(np.polyval([-0.9549476, -1.37418593, 2.09137015, -0.16748867], x))
    return x, float(np.polyval([3.0817580, -5.87338670, 3.75112997, -0.37001483], x))


def _check_colours(name: str, colours: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(colours, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InputError(f"{name}: shape {array.shape} found, (..., 3) expected")
    return array


def _colour() -> Any:
    if "colour" not in sys.modules:
        # colour-science would keep OpenImageIO's types in a table that outlives the interpreter, which then
        # prints thirty lines about leaks at exit; its image files are not used here.
        kept = sys.modules.get("OpenImageIO")
        sys.modules["OpenImageIO"] = None  # type: ignore[assignment]
        try:
            with np.printoptions():  # the package changes how NumPy prints, for everybody
                import colour  # noqa: F401
        finally:
            del sys.modules["OpenImageIO"]
            if kept is not None:
                sys.modules["OpenImageIO"] = kept
    return sys.modules["colour"]
