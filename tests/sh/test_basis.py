"""Pins of the SH convention: order, signs and constants against the paper, SciPy and Dr.Jit."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import lebedev_rule

from sfsnet_dr.core import runtime
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.sh.basis import basis_index, from_scipy, sh_basis, to_drjit_index

#: Worst difference seen between our recurrence and SciPy's or Dr.Jit's float64 forms was 3.5e-15; times 6.
ROUNDING = 2e-14


def directions(count: int = 500) -> NDArray[np.float64]:
    vectors = np.random.default_rng(7).normal(size=(count, 3))
    unit: NDArray[np.float64] = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.concatenate([unit, np.eye(3), -np.eye(3)])


def test_first_nine_are_the_papers() -> None:
    """SfSNet's appendix, equation by equation."""
    x, y, z = directions().T
    c = 1 / (4 * np.pi)
    paper = [
        np.sqrt(c) * np.ones_like(x),
        np.sqrt(3 * c) * z,
        np.sqrt(3 * c) * x,
        np.sqrt(3 * c) * y,
        1 / 2 * np.sqrt(5 * c) * (3 * z**2 - 1),
        3 * np.sqrt(5 / 3 * c) * x * z,
        3 * np.sqrt(5 / 3 * c) * y * z,
        3 / 2 * np.sqrt(5 / 3 * c) * (x**2 - y**2),
        3 * np.sqrt(5 / 3 * c) * x * y,
    ]
    np.testing.assert_allclose(sh_basis(directions(), 2), np.stack(paper, axis=-1), atol=ROUNDING)


def test_scipy_map() -> None:
    d = directions()
    theta, phi = np.arccos(d[:, 2]), np.arctan2(d[:, 1], d[:, 0])
    np.testing.assert_allclose(sh_basis(d, 8), from_scipy(8, theta, phi), atol=ROUNDING)


def test_drjit_map() -> None:
    runtime.start()
    import drjit as dr
    import mitsuba as mi

    d = directions()
    theirs = dr.sh_eval(mi.Vector3d(np.ascontiguousarray(d.T)), 8)
    values = np.stack([np.broadcast_to(np.array(value), len(d)) for value in theirs], axis=-1)
    index, sign = to_drjit_index(8)
    np.testing.assert_allclose(sh_basis(d, 8), sign * values[:, index], atol=ROUNDING)


def test_orthonormal_over_the_sphere() -> None:
    """Lebedev's rule of degree 17 integrates products of two order-8 functions exactly."""
    points, weights = lebedev_rule(17)
    values = sh_basis(points.T, 8)
    gram = (values * weights[:, None]).T @ values
    np.testing.assert_allclose(gram, np.eye(81), atol=1e-12)  # SciPy gives the weights to about 12 digits


def test_index_names_the_functions() -> None:
    assert [basis_index(1, 0), basis_index(1, 1), basis_index(1, 1, odd=True)] == [1, 2, 3]
    assert basis_index(2, 2, odd=True) == 8
    assert basis_index(8, 8, odd=True) == 80


def test_keeps_leading_dimensions() -> None:
    d = directions(10)[:12].reshape(3, 4, 3)
    assert sh_basis(d, 3).shape == (3, 4, 16)
    np.testing.assert_array_equal(sh_basis(d, 3)[1, 2], sh_basis(d[1, 2], 3))


def test_bad_input() -> None:
    with pytest.raises(InputError, match=r"directions: shape \(5, 2\) found"):
        sh_basis(np.zeros((5, 2)), 2)
    with pytest.raises(InputError, match="order: 9 found"):
        sh_basis(np.zeros(3), 9)
