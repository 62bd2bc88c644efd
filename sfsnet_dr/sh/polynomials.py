"""The basis to order 4 as explicit polynomials, and as monomials with derivatives for kernels.

Written out rather than computed by recurrence: it is what the differentiable renderers evaluate per pixel,
and it is independent of the recurrence in ``basis`` that tests hold it against. Order and signs as there.

The terms come from ``polynomials`` itself, by feeding it polynomials instead of numbers, so that there is
one table of constants. Each basis function is split into a scale and a polynomial whose largest coefficient
is 1: kernels multiply the light by the scale once an image and save a product a pixel and function.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
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
        InputError: if the order is out of range.
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


Powers = tuple[int, int, int]

#: Powers of the monomial 1.
CONSTANT: Powers = (0, 0, 0)


@dataclass(frozen=True)
class Polynomial:
    """Coefficient of each monomial, by the powers of x, y and z; none is 0."""

    terms: tuple[tuple[Powers, float], ...]

    @staticmethod
    def of(terms: dict[Powers, float]) -> Polynomial:
        return Polynomial(tuple((p, c) for p, c in sorted(terms.items(), reverse=True) if c != 0))

    def __add__(self, other: Polynomial | float) -> Polynomial:
        total = dict(self.terms)
        for powers, coefficient in _lift(other).terms:
            total[powers] = total.get(powers, 0) + coefficient
        return Polynomial.of(total)

    def __sub__(self, other: Polynomial | float) -> Polynomial:
        return self + _lift(other) * -1

    def __mul__(self, other: Polynomial | float) -> Polynomial:
        total: dict[Powers, float] = {}
        for a, ca in self.terms:
            for b, cb in _lift(other).terms:
                powers = (a[0] + b[0], a[1] + b[1], a[2] + b[2])
                total[powers] = total.get(powers, 0) + ca * cb
        return Polynomial.of(total)

    __rmul__ = __mul__
    __radd__ = __add__

    def derivative(self, axis: int) -> Polynomial:
        """By x, y or z (axis 0, 1, 2), as if the three were independent."""
        lowered = {}
        for powers, coefficient in self.terms:
            if powers[axis]:
                to = tuple(p - (i == axis) for i, p in enumerate(powers))
                lowered[to] = coefficient * powers[axis]
        return Polynomial.of(lowered)  # type: ignore[arg-type]


@dataclass(frozen=True)
class BasisFunction:
    """One basis function: scale * shape, and the derivatives of shape by x, y and z."""

    scale: float
    shape: Polynomial
    slopes: tuple[Polynomial, Polynomial, Polynomial]


@cache
def basis_functions(order: int) -> tuple[BasisFunction, ...]:
    """The (order + 1)^2 functions of ``sh_polynomials``, in its order.

    Args:
        order: 0 to 4.
    """
    x, y, z = (Polynomial.of({p: 1.0}) for p in ((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    return tuple(_scaled(_lift(f)) for f in sh_polynomials(x, y, z, order))


class Evaluator:
    """Polynomials at one point, each product of powers computed once."""

    def __init__(self, point: Sequence[Any], fma: Callable[[Any, Any, Any], Any]) -> None:
        """Point: x, y, z of one arithmetic type; fma: (a, b, c) -> a b + c."""
        self._axes, self._fma = point, fma
        self._known: dict[Powers, Any] = dict(zip(((1, 0, 0), (0, 1, 0), (0, 0, 1)), point, strict=True))

    def __call__(self, polynomial: Polynomial) -> Any:
        """Its value; a Python float for a constant one."""
        total: Any = None
        for powers, coefficient in polynomial.terms:  # a constant comes last
            if powers == CONSTANT:
                total = coefficient if total is None else total + coefficient
            elif total is None:
                total = self.monomial(powers) * coefficient if coefficient != 1 else self.monomial(powers)
            elif coefficient == -1:
                total = total - self.monomial(powers)
            elif coefficient == 1:
                total = total + self.monomial(powers)
            else:
                total = self._fma(self.monomial(powers), coefficient, total)
        return 0.0 if total is None else total

    def monomial(self, powers: Powers) -> Any:
        """x^i y^j z^k, not all powers 0."""
        if powers not in self._known:
            axis = next(i for i in range(3) if powers[i])
            i, j, k = (p - (at == axis) for at, p in enumerate(powers))
            self._known[powers] = self._axes[axis] * self.monomial((i, j, k))
        return self._known[powers]


def _lift(value: Polynomial | float) -> Polynomial:
    return value if isinstance(value, Polynomial) else Polynomial.of({CONSTANT: float(value)})


def _scaled(function: Polynomial) -> BasisFunction:
    scale = max((c for _, c in function.terms), key=abs)
    shape = function * (1 / scale)
    # The largest coefficient is exactly 1, whatever the division rounds to.
    shape = Polynomial(tuple((p, round(c) if abs(c - round(c)) < 1e-14 else c) for p, c in shape.terms))
    return BasisFunction(scale, shape, (shape.derivative(0), shape.derivative(1), shape.derivative(2)))
