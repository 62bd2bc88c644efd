"""The clamped-cosine kernel: how a Lambertian surface filters each band of the light."""

from __future__ import annotations

import math
import operator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.core.errors import InputError

#: Highest order of the NumPy basis and of everything built on it.
MAX_ORDER: Final = 8


def clamped_cosine(order: int) -> NDArray[np.float64]:
    """Kernel coefficients A_l, l = 0..order: the irradiance of band l is A_l times its radiance.

    A_0 = pi, A_1 = 2 pi/3, A_l = 0 for odd l > 1, and for even l
    A_l = 2 pi (-1)^(l/2-1) / ((l+2)(l-1)) * l! / (2^l ((l/2)!)^2).
    Source: Ramamoorthi and Hanrahan, "On the relationship between radiance and irradiance", JOSA A 2001.

    Returns:
        (order + 1,) float64, in steradian.
    """
    return np.array([_band_factor(band) for band in range(order + 1)])


def band_of(order: int) -> NDArray[np.int64]:
    """Band l of every basis index: (K,) with K = (order + 1)^2, values 0, 1, 1, 1, 2, ..."""
    return np.repeat(np.arange(order + 1), 2 * np.arange(order + 1) + 1)


def check_order(order: int, highest: int = MAX_ORDER) -> int:
    """Return the order as an int.

    Raises:
        InputError: if it is outside 0..highest.
    """
    order = operator.index(order)
    if not 0 <= order <= highest:
        raise InputError(f"order: {order} found, 0 to {highest} allowed")
    return order


def order_of(count: int, highest: int = MAX_ORDER) -> int:
    """Order whose basis has ``count`` functions.

    Raises:
        InputError: if ``count`` is not (order + 1)^2 for an order in 0..highest.
    """
    order = math.isqrt(max(count, 0)) - 1
    if (order + 1) ** 2 != count or not 0 <= order <= highest:
        allowed = ", ".join(str((n + 1) ** 2) for n in range(highest + 1))
        raise InputError(f"coefficients: {count} found, one of {allowed} per colour allowed")
    return order


def _band_factor(band: int) -> float:
    if band == 1:
        return 2 * math.pi / 3
    if band % 2:
        return 0.0
    if band == 0:
        return math.pi
    half = band // 2
    sign = -1 if half % 2 == 0 else 1
    return 2 * math.pi * sign * math.comb(band, half) / ((band + 2) * (band - 1) * math.pow(2, band))
