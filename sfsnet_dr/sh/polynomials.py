"""The basis to order 4 as explicit polynomials, for whatever has +, - and *: torch, Dr.Jit, floats.

Written out rather than computed by recurrence: it is what the differentiable renderers evaluate per pixel,
and it is independent of the recurrence in ``basis`` that tests hold it against. Order and signs as there.
"""

from __future__ import annotations

import math
from typing import Any, Final

from sfsnet_dr.sh.kernel import check_order

#: Highest order of the differentiable forms.
MAX_POLYNOMIAL_ORDER: Final = 4

_C0 = 1 / 2 * math.sqrt(1 / math.pi)
_C1 = 1 / 2 * math.sqrt(3 / math.pi)
_C20, _C2, _C22E = (
    1 / 4 * math.sqrt(5 / math.pi),
    1 / 2 * math.sqrt(15 / math.pi),
    1 / 4 * math.sqrt(15 / math.pi),
)
_C30, _C31 = 1 / 4 * math.sqrt(7 / math.pi), 1 / 4 * math.sqrt(21 / 2 / math.pi)
_C32E, _C32O = 1 / 4 * math.sqrt(105 / math.pi), 1 / 2 * math.sqrt(105 / math.pi)
_C33 = 1 / 4 * math.sqrt(35 / 2 / math.pi)
_C40, _C41 = 3 / 16 * math.sqrt(1 / math.pi), 3 / 4 * math.sqrt(5 / 2 / math.pi)
_C42E, _C42O = 3 / 8 * math.sqrt(5 / math.pi), 3 / 4 * math.sqrt(5 / math.pi)
_C43 = 3 / 4 * math.sqrt(35 / 2 / math.pi)
_C44E, _C44O = 3 / 16 * math.sqrt(35 / math.pi), 3 / 4 * math.sqrt(35 / math.pi)


def sh_polynomials(x: Any, y: Any, z: Any, order: int) -> list[Any]:
    """Basis functions of a unit direction, one entry each.

    Args:
        x, y, z: components of unit vectors, of one arithmetic type and shape; not normalised here.
        order: 0 to 4.

    Returns:
        List of (order + 1)^2 values of the same type; the first, a constant, is a Python float.

    Raises:
        BadInput: if the order is out of range.
    """
    bands = (_band0, _band1, _band2, _band3, _band4)
    order = check_order(order, MAX_POLYNOMIAL_ORDER)
    return [value for band in bands[: order + 1] for value in band(x, y, z)]


def _band0(x: Any, y: Any, z: Any) -> list[Any]:
    return [_C0]


def _band1(x: Any, y: Any, z: Any) -> list[Any]:
    return [_C1 * z, _C1 * x, _C1 * y]


def _band2(x: Any, y: Any, z: Any) -> list[Any]:
    return [
        _C20 * (3 * z * z - 1),
        _C2 * x * z,
        _C2 * y * z,
        _C22E * (x * x - y * y),
        _C2 * x * y,
    ]


def _band3(x: Any, y: Any, z: Any) -> list[Any]:
    xx, yy, zz = x * x, y * y, z * z
    return [
        _C30 * z * (5 * zz - 3),
        _C31 * x * (5 * zz - 1),
        _C31 * y * (5 * zz - 1),
        _C32E * z * (xx - yy),
        _C32O * x * y * z,
        _C33 * x * (xx - 3 * yy),
        _C33 * y * (3 * xx - yy),
    ]


def _band4(x: Any, y: Any, z: Any) -> list[Any]:
    xx, yy, zz = x * x, y * y, z * z
    return [
        _C40 * (zz * (35 * zz - 30) + 3),
        _C41 * x * z * (7 * zz - 3),
        _C41 * y * z * (7 * zz - 3),
        _C42E * (xx - yy) * (7 * zz - 1),
        _C42O * x * y * (7 * zz - 1),
        _C43 * x * z * (xx - 3 * yy),
        _C43 * y * z * (3 * xx - yy),
        _C44E * (xx * (xx - 3 * yy) - yy * (3 * xx - yy)),
        _C44O * x * y * (xx - yy),
    ]
