from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.sh.coefficients import Radiance
from sfsnet_dr.sh.kernel import band_of
from sfsnet_dr.sh.rotation import rotate, rotation_matrix, sphere_quadrature

#: Sums of 153 products of size 1: 5e-15 seen over 200 rotations, times 20.
ROUNDING = 1e-13


def random_rotation(seed: int) -> NDArray[np.float64]:
    matrix: NDArray[np.float64] = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    return matrix


def random_light(order: int = 8) -> Radiance:
    return Radiance(np.random.default_rng(1).normal(size=((order + 1) ** 2, 3)))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_what_came_from_d_comes_from_r_d(seed: int) -> None:
    rotation, light = random_rotation(seed), random_light()
    d = np.random.default_rng(seed).normal(size=(20, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    turned = rotate(light, rotation)
    np.testing.assert_allclose(
        turned.evaluate(d @ rotation.T), light.evaluate(d), atol=1e-12
    )  # 81 terms of size 3


def test_quarter_turn_about_y_takes_front_light_to_the_right() -> None:
    """By hand: +z goes to +x, so the z coefficient becomes the x coefficient."""
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    light = Radiance(np.array([[0.0], [1], [0], [0]]) * np.ones(3))
    np.testing.assert_allclose(rotate(light, quarter).values[:, 0], [0, 0, 1, 0], atol=ROUNDING)


def test_two_turns_are_one() -> None:
    first, second = random_rotation(1), random_rotation(2)
    both = rotation_matrix(second, 8) @ rotation_matrix(first, 8)
    np.testing.assert_allclose(rotation_matrix(second @ first, 8), both, atol=ROUNDING)


def test_blocks_by_band_and_orthogonal() -> None:
    matrix = rotation_matrix(random_rotation(4), 8)
    band = band_of(8)
    np.testing.assert_allclose(matrix[band[:, None] != band[None, :]], 0, atol=ROUNDING)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(81), atol=ROUNDING)


def test_left_right_mirror_negates_what_is_odd_in_x() -> None:
    """x, xz and xy change sign; read off the paper's nine polynomials."""
    mirror = rotation_matrix(np.diag([-1.0, 1, 1]), 2)
    np.testing.assert_allclose(mirror, np.diag([1, 1, -1, 1, 1, -1, 1, 1, -1]), atol=ROUNDING)


def test_quadrature_integrates_known_polynomials() -> None:
    points, weights = sphere_quadrature(6)
    x, y, z = points.T
    assert weights.sum() == pytest.approx(4 * np.pi, rel=1e-14)
    assert weights @ z**2 == pytest.approx(4 * np.pi / 3, rel=1e-13)
    assert weights @ (x**2 * y**2 * z**2) == pytest.approx(4 * np.pi / 105, rel=1e-13)


@pytest.mark.parametrize("bad", [np.eye(2), 2 * np.eye(3), np.full((3, 3), np.nan)])
def test_bad_input(bad: NDArray[np.float64]) -> None:
    with pytest.raises(InputError, match="rotation: "):
        rotation_matrix(bad, 2)
