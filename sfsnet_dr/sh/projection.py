"""Environment maps and directional lights as radiance coefficients.

Convention of equirectangular images (that of Mitsuba's ``envmap`` with identity ``to_world``):
    A direction (x, y, z) lies at u = atan2(x, -z) / 2 pi (mod 1) and v = acos(y) / pi. Column j has its
    centre at u = (j + 1/2) / W and wraps around; row i has its centre at v = i / (H - 1), so that the first
    row *is* the zenith +y and the last row the nadir. Between centres the image is interpolated bilinearly in
    u and v. The middle of the image is +z, where the viewer stands; columns to its right are toward -x.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.sh.basis import basis_index, sh_basis
from sfsnet_dr.sh.coefficients import Radiance
from sfsnet_dr.sh.kernel import check_order
from sfsnet_dr.sh.rotation import rotation_matrix

#: Gauss points per row interval; the integrand there is a hat times a trigonometric polynomial of degree 9.
_ROW_NODES = 12

#: The map's own frame has its pole as z: columns are its axes x (-z, u = 0), y (-x) and z (+y) in ours.
_MAP_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])


def equirect_directions(height: int, width: int) -> NDArray[np.float64]:
    """Unit directions of the texel centres, (H, W, 3); see the module's convention.

    Raises:
        InputError: if the image would be smaller than 3 x 3.
    """
    _check_size(height, width)
    theta = np.pi * np.arange(height) / (height - 1)
    phi = 2 * np.pi * (np.arange(width) + 0.5) / width
    sine = np.sin(theta)[:, None]
    height_axis = np.broadcast_to(np.cos(theta)[:, None], (height, width))
    return np.stack([sine * np.sin(phi), height_axis, -sine * np.cos(phi)], axis=-1)


def equirect_solid_angles(height: int, width: int) -> NDArray[np.float64]:
    """Solid angle (H, W), steradian, of each texel: the integral of its bilinear hat. They sum to 4 pi."""
    _check_size(height, width)
    rows = _row_integrals(height, 0)[0] * np.sqrt(4 * np.pi)
    return np.repeat(rows[:, None] * (2 * np.pi / width), width, axis=1)


def project_equirect(image: ArrayLike, order: int) -> Radiance:
    """Coefficients of an equirectangular image: of the bilinear function that Mitsuba evaluates.

    The integral is exact to rounding: in the map's own frame the basis is a function of the row times a
    cosine or sine of the column, so that rows and columns are integrated apart; the result is then turned.

    Args:
        image: (H, W, 3) linear radiance, at least 3 x 3; finite.
        order: 0 to 8.

    Returns:
        Radiance coefficients (K, 3).

    Raises:
        InputError: if the shape is wrong or a value is not finite.
    """
    pixels = np.asarray(image, dtype=np.float64)
    if pixels.ndim != 3 or pixels.shape[2] != 3:
        raise InputError(f"environment map: shape {pixels.shape} found, (H, W, 3) expected")
    height, width, _ = pixels.shape
    _check_size(height, width)
    order = check_order(order)
    values = np.empty(((order + 1) ** 2, 3))
    rows = _row_integrals(height, order)
    for m in range(order + 1):
        for odd, column in enumerate(_column_integrals(width, m)):
            by_row = np.einsum("hwc,w->hc", pixels, column)
            for band in range(m, order + 1):
                values[basis_index(band, m, bool(odd))] = rows[basis_index(band, m)] @ by_row
    return Radiance(rotation_matrix(_MAP_AXES, order) @ values)


def project_directional(direction: ArrayLike, irradiance: ArrayLike, order: int) -> Radiance:
    """Coefficients of one infinitely distant light: l_lm = E Y_lm(direction).

    Args:
        direction: (3,) from the surface toward the light; normalised here.
        irradiance: (3,) on a surface that faces the light; its shading is irradiance / pi there.
        order: 0 to 8.

    Returns:
        Radiance coefficients (K, 3).

    Raises:
        InputError: for wrong shapes or a direction without length.
    """
    vector, power = np.asarray(direction, dtype=np.float64), np.asarray(irradiance, dtype=np.float64)
    for name, found in (("direction", vector), ("irradiance", power)):
        if found.shape != (3,):
            raise InputError(f"{name}: shape {found.shape} found, (3,) expected")
    length = float(np.linalg.norm(vector))
    if not 0 < length < np.inf:
        raise InputError(f"direction: length {length} found, a finite vector other than zero expected")
    return Radiance(np.outer(sh_basis(vector / length, order), power))


def _check_size(height: int, width: int) -> None:
    # Of fewer rows Mitsuba makes three by a resampling of its own.
    if height < 3 or width < 3:
        raise InputError(f"environment map: {height} x {width} found, at least 3 x 3 expected")


def _row_integrals(height: int, order: int) -> NDArray[np.float64]:
    """(K, H): hat of each row times sin(theta) against the basis at azimuth 0 of the map's frame."""
    nodes, weights = np.polynomial.legendre.leggauss(_ROW_NODES)
    share = (nodes + 1) / 2  # of the lower row of the interval
    step = np.pi / (height - 1)
    theta = (np.arange(height - 1)[:, None] + share) * step
    at_azimuth_0 = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)
    integrand = sh_basis(at_azimuth_0, order) * (np.sin(theta) * weights * step / 2)[..., None]
    rows = np.zeros(((order + 1) ** 2, height))
    rows[:, :-1] += np.einsum("isk,s->ki", integrand, 1 - share)
    rows[:, 1:] += np.einsum("isk,s->ki", integrand, share)
    return rows


def _column_integrals(width: int, m: int) -> list[NDArray[np.float64]]:
    """Hat of each column (W,) against cos(m phi) and, for m > 0, sin(m phi) of the map's frame."""
    step = 2 * np.pi / width
    phi = -step * (np.arange(width) + 0.5)  # the map's columns run against its azimuth
    if m == 0:
        return [np.full(width, step)]
    smoothing = step * np.sinc(m / width) ** 2  # Fourier transform of the hat
    return [smoothing * np.cos(m * phi), smoothing * np.sin(m * phi)]
