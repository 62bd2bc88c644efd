"""Angles between normals, against rotations of known angle."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.metrics.normals import angles_deg, angular_error_deg


@pytest.mark.parametrize("angle", [0.0, 1e-7, 0.01, 19.9, 90, 179.99, 180])
def test_a_rotation_shows_its_angle(angle: float) -> None:
    rng = np.random.default_rng(0)
    vector = rng.standard_normal((50, 3))
    axis = np.cross(vector, rng.standard_normal((50, 3)))
    axis *= np.radians(angle) / np.linalg.norm(axis, axis=1, keepdims=True)
    turned = Rotation.from_rotvec(axis).apply(vector) * rng.uniform(0.1, 9, (50, 1))
    # Double precision holds 2e-16 radians, 1.3e-14 degrees; worst seen 6e-14.
    np.testing.assert_allclose(angles_deg(vector, turned), angle, rtol=0, atol=3e-13)


def test_statistics_over_the_mask() -> None:
    angles = np.radians([[10.0, 20.1, 24.0], [29.0, 40.0, 170.0]])
    turned = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=-1)
    frontal = np.zeros((2, 3, 3))
    frontal[..., 2] = 1
    mask = np.array([[1, 1, 1], [1, 1, 0]])
    errors = angular_error_deg(turned, frontal, mask)
    counted = np.array([10, 20.1, 24, 29, 40])
    assert errors.mean == pytest.approx(counted.mean())
    assert errors.std == pytest.approx(counted.std())
    assert (errors.below20, errors.below25, errors.below30, errors.pixels) == (20, 60, 80, 5)


def test_zero_normals_outside_the_mask_do_not_matter() -> None:
    normal = np.zeros((4, 4, 3))
    normal[:2, :, 2] = 1
    assert angular_error_deg(normal, normal, normal[..., 2]).mean == 0


def test_bad_input_is_named() -> None:
    normal = np.ones((4, 4, 3))
    with pytest.raises(InputError, match="mask: no pixel"):
        angular_error_deg(normal, normal, np.zeros((4, 4)))
    with pytest.raises(InputError, match=r"b: shape \(3, 4, 4\)"):
        angular_error_deg(normal, np.ones((3, 4, 4)), np.ones((4, 4)))
    with pytest.raises(InputError, match="a: a zero, NaN or infinite normal"):
        angular_error_deg(normal * 0, normal, np.ones((4, 4)))
    with pytest.raises(InputError, match="b: a zero, NaN or infinite normal"):
        angular_error_deg(normal, normal * np.nan, np.ones((4, 4)))
