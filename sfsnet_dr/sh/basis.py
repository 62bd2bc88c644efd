"""Real spherical harmonics in float64: the oracle that the torch and Dr.Jit forms are held against.

Convention:
    Real functions with positive constants (no Condon-Shortley sign), orthonormal over the sphere, polar axis
    z. Order within band l: m = 0, then 1 even (cosine), 1 odd (sine), 2 even, 2 odd, and so on; so the first
    nine are 1, z, x, y, 3z^2-1, xz, yz, x^2-y^2, xy up to constants. Source: SfSNet (CVPR 2018), appendix.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.sh.kernel import check_order


def sh_basis(directions: ArrayLike, order: int) -> NDArray[np.float64]:
    """Evaluate all basis functions up to an order.

    Args:
        directions: (..., 3) unit vectors x, y, z. They are not normalised here.
        order: 0 to 8.

    Returns:
        (..., K) float64 with K = (order + 1)^2.

    Raises:
        InputError: if the last dimension is not 3 or the order is out of range.
    """
    order = check_order(order)
    vectors = np.asarray(directions, dtype=np.float64)
    if vectors.ndim == 0 or vectors.shape[-1] != 3:
        raise InputError(f"directions: shape {vectors.shape} found, (..., 3) expected")
    x, y, z = np.moveaxis(vectors, -1, 0)
    values = np.empty((*vectors.shape[:-1], (order + 1) ** 2))
    cosine, sine = np.ones_like(z), np.zeros_like(z)  # sin(theta)^m times cos(m phi), sin(m phi)
    for m in range(order + 1):
        for band, legendre in zip(range(m, order + 1), _legendre_over_sine(m, order, z), strict=True):
            scaled = _normaliser(band, m) * legendre
            if m == 0:
                values[..., band**2] = scaled
            else:
                values[..., band**2 + 2 * m - 1] = scaled * cosine
                values[..., band**2 + 2 * m] = scaled * sine
        cosine, sine = x * cosine - y * sine, x * sine + y * cosine
    return values


def basis_index(band: int, m: int, odd: bool = False) -> int:
    """Place of the function of band l, frequency m >= 0, even (cosine) or odd (sine)."""
    return band**2 + (0 if m == 0 else 2 * m - 1 + odd)


def to_drjit_index(order: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Index and sign, (K,) each, with ``ours[k] = sign[k] * drjit.sh_eval(d, order)[index[k]]``.

    Dr.Jit orders a band by m = -l..l (sine terms first) and keeps the Condon-Shortley sign (-1)^m.
    """
    terms = _terms(check_order(order))
    index = np.array([band**2 + band + (-m if odd else m) for band, m, odd in terms])
    sign = np.array([(-1.0) ** m for _, m, _ in terms])
    return index, sign


def from_scipy(order: int, theta: ArrayLike, phi: ArrayLike) -> NDArray[np.float64]:
    """The same basis from ``scipy.special.sph_harm_y``: the map to SciPy, as the code that applies it.

    Args:
        order: 0 to 8.
        theta: polar angle from +z, radians.
        phi: azimuth from +x toward +y, radians; broadcasts against ``theta``.

    Returns:
        (..., K) float64: sqrt(2) (-1)^m Re Y_l^m (even) and sqrt(2) (-1)^m Im Y_l^m (odd), and Y_l^0.
    """
    from scipy.special import sph_harm_y

    columns = []
    for band, m, odd in _terms(check_order(order)):
        value = sph_harm_y(band, m, theta, phi)
        factor = (-1.0) ** m * (math.sqrt(2) if m else 1.0)
        columns.append(factor * (value.imag if odd else value.real))
    return np.stack(columns, axis=-1)


def _terms(order: int) -> list[tuple[int, int, bool]]:
    """(band, m, odd) of every basis function, in order."""
    terms = []
    for band in range(order + 1):
        terms.append((band, 0, False))
        terms += [(band, m, odd) for m in range(1, band + 1) for odd in (False, True)]
    return terms


def _normaliser(band: int, m: int) -> float:
    ratio = math.factorial(band - m) / math.factorial(band + m)
    return math.sqrt((2 * band + 1) / (4 * math.pi) * ratio * (2 if m else 1))


def _legendre_over_sine(m: int, order: int, z: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """P_l^m(z) / sin(theta)^m without the sign (-1)^m, for l = m..order, by the three-term recurrence."""
    current = np.full_like(z, math.prod(range(1, 2 * m, 2)))
    before = np.zeros_like(z)
    found = [current]
    for band in range(m + 1, order + 1):
        before, current = current, ((2 * band - 1) * z * current - (band + m - 1) * before) / (band - m)
        found.append(current)
    return found
