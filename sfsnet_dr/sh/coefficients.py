"""Light as SH coefficients in its two forms, kept apart by type.

*Radiance* coefficients l_lm describe the environment. *Shading* coefficients L_lm = A_l l_lm / pi describe
what a Lambertian surface of albedo 1 reflects: S(n) = Y(n)^T L, image = albedo * S. A constant environment of
radiance 1 gives S = 1. The two differ by (1, 2/3, 1/4) in bands 0, 1, 2, so that mixing them gives plausible,
wrong pictures.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.kernel import band_of, check_order, clamped_cosine, order_of


@dataclass(frozen=True, eq=False)
class _Coefficients:
    """Coefficients of one light for three colours.

    Attributes:
        values: (K, 3) float64, read-only; basis functions in the order of ``sfsnet_dr.sh.basis``,
            columns R, G, B (linear, Rec. 709).

    Raises:
        InputError: if the shape is not (K, 3) with K = 1, 4, 9, ..., 81, or a value is not finite.
    """

    values: NDArray[np.float64]

    def __post_init__(self) -> None:
        values = np.array(self.values, dtype=np.float64)
        name = type(self).__name__
        if values.ndim != 2 or values.shape[1] != 3:
            raise InputError(f"{name}: shape {values.shape} found, (K, 3) expected")
        order_of(values.shape[0])
        if not np.isfinite(values).all():
            raise InputError(f"{name}: NaN or inf found, finite coefficients expected")
        values.setflags(write=False)
        object.__setattr__(self, "values", values)

    @classmethod
    def from_flat(cls, flat: ArrayLike) -> Self:
        """From (3K,) numbers: K of red, K of green, K of blue, the network's layout."""
        numbers = np.asarray(flat, dtype=np.float64)
        if numbers.ndim != 1 or numbers.size % 3:
            raise InputError(f"{cls.__name__}: shape {numbers.shape} found, (3 K,) expected")
        return cls(numbers.reshape(3, -1).T)

    @property
    def order(self) -> int:
        """Highest band."""
        return order_of(self.values.shape[0])

    def flat(self) -> NDArray[np.float64]:
        """(3K,) numbers: K of red, K of green, K of blue."""
        return np.ascontiguousarray(self.values.T).reshape(-1)

    def truncate(self, order: int) -> Self:
        """Keep bands 0..order.

        Raises:
            InputError: if the order is above this one's.
        """
        order = check_order(order, self.order)
        return type(self)(self.values[: (order + 1) ** 2])

    def evaluate(self, directions: ArrayLike) -> NDArray[np.float64]:
        """The expansion at unit directions or normals (..., 3): (..., 3) colours, possibly negative."""
        return np.asarray(sh_basis(directions, self.order) @ self.values)

    def __add__(self, other: Self) -> Self:
        """Both lights together. Radiance and shading, or two orders, do not add: TypeError, InputError."""
        if not isinstance(other, type(self)):
            raise TypeError(f"{type(self).__name__} + {type(other).__name__}: convert one of them first")
        if other.order != self.order:
            raise InputError(
                f"{type(self).__name__}: orders {self.order} and {other.order} found, equal ones expected"
            )
        return type(self)(self.values + other.values)

    def __mul__(self, factor: Any) -> Self:
        """Scale by a number, or by (3,) numbers, one per colour. Two lights do not multiply: TypeError."""
        if isinstance(factor, _Coefficients):
            raise TypeError(
                f"{type(self).__name__} * {type(factor).__name__}: a light is scaled by numbers only"
            )
        return type(self)(self.values * np.asarray(factor, dtype=np.float64))

    __rmul__ = __mul__


@dataclass(frozen=True, eq=False)
class Radiance(_Coefficients):
    """Coefficients l_lm of the environment's radiance; fields and errors as in ``_Coefficients``."""

    def to_shading(self) -> Shading:
        """What a convex Lambertian surface of albedo 1 shows: L_lm = A_l l_lm / pi."""
        return Shading(self.values * _shading_factors(self.order)[:, None])


@dataclass(frozen=True, eq=False)
class Shading(_Coefficients):
    """Coefficients L_lm of Lambertian shading; the network's 27 numbers are these, of order 2."""

    def to_radiance(self) -> Radiance:
        """The environment behind this shading: l_lm = pi L_lm / A_l.

        Raises:
            InputError: above order 2, where A_3 = 0 leaves the odd bands of the light undetermined.
        """
        if self.order > 2:
            raise InputError(
                f"Shading: order {self.order} found, at most 2 can become radiance; truncate it first"
            )
        return Radiance(self.values / _shading_factors(self.order)[:, None])


def _shading_factors(order: int) -> NDArray[np.float64]:
    return (clamped_cosine(order) / np.pi)[band_of(order)]
