"""The basis as monomials: the polynomials themselves and finite differences of them are the oracles."""

from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.sh.polynomials import Evaluator, basis_functions, sh_polynomials


def _values(order: int, point: list[float]) -> list[float]:
    x, y, z = point
    return [float(v) for v in sh_polynomials(x, y, z, order)]


@pytest.mark.parametrize("order", range(5))
def test_scale_times_shape_is_the_basis(order: int) -> None:
    rng = np.random.default_rng(order)
    for _ in range(5):
        point = [float(v) for v in rng.uniform(-1, 1, 3)]  # of any length: the polynomials themselves count
        at = Evaluator(point, lambda a, b, c: a * b + c)
        found = [f.scale * at(f.shape) for f in basis_functions(order)]
        # Round-off: sums of up to 6 terms below 15, worst of 100 points 5e-15.
        np.testing.assert_allclose(found, _values(order, point), rtol=0, atol=3e-14)


@pytest.mark.parametrize("axis", range(3))
def test_slopes_are_finite_differences(axis: int) -> None:
    point, step = [0.3, -0.5, 0.7], 1e-5
    at = Evaluator(point, lambda a, b, c: a * b + c)
    ends = [[p + sign * step * (i == axis) for i, p in enumerate(point)] for sign in (1, -1)]
    above, below = (np.array(_values(4, end)) for end in ends)
    found = [f.scale * at(f.slopes[axis]) for f in basis_functions(4)]
    # Third derivatives up to 60 times step^2 / 6 is 1e-9; round-off of the difference 1e-10.
    np.testing.assert_allclose(found, (above - below) / (2 * step), rtol=0, atol=5e-9)


def test_largest_coefficient_is_one() -> None:
    for function in basis_functions(4):
        assert max((c for _, c in function.shape.terms), key=abs) == 1
