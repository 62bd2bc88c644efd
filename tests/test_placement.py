"""The canonical frame: eyes land where they must, and the signs of a pose mean what they say."""

from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.scene.placement import Pose, place, project
from sfsnet_dr.scene.spec import CameraSpec, HeadSpec

EYES = np.array([[-0.3, 7.3, 1.2], [0.3, 7.3, 1.2]])
NOSE = np.array([[0.0, 6.9, 1.7]])
CHIN = np.array([[0.0, 6.2, 1.4]])


def pinhole(points: np.ndarray, distance: float) -> np.ndarray:
    """Pixels by similar triangles, written out apart from the code under test."""
    x = points[:, 0] * distance / (distance - points[:, 2])
    y = points[:, 1] * distance / (distance - points[:, 2])
    return np.stack([64 + 64 * x, 64 - 64 * y], axis=1)


def placed(pose: Pose, camera: CameraSpec = CameraSpec()) -> np.ndarray:  # noqa: B008  (frozen)
    return place(np.concatenate([EYES, NOSE, CHIN]), EYES, pose, camera)


def test_a_frontal_face_has_its_eyes_at_the_canonical_pixels() -> None:
    seen = pinhole(placed(Pose()), 12.0)
    np.testing.assert_allclose(seen[:2], [[45, 48], [83, 48]], atol=1e-6)
    assert seen[2, 0] == pytest.approx(64, abs=1e-6)
    assert seen[3, 1] > seen[2, 1] > 48  # the chin below the nose below the eyes


@pytest.mark.parametrize("seed", range(8))
def test_any_pose_brings_the_eyes_to_its_similarity_transform(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = CameraSpec(distance=float(rng.uniform(4, 40)))
    head = HeadSpec(yaw=55, pitch=28, roll=30, scale_jitter=0.2, shift_jitter=6)
    pose = Pose.sample(rng, head)
    centre, angle = np.array([64.0, 64.0]), np.radians(pose.roll)
    # Counter-clockwise as seen; rows run down, so the sine changes sign.
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    canonical = np.array([[45.0, 48.0], [83.0, 48.0]])
    target = centre + pose.scale * (canonical - centre) @ turn.T + pose.shift
    # .01 pixel is what `place` promises for strong turns close to the camera; typical is 1e-6.
    np.testing.assert_allclose(pinhole(placed(pose, camera), camera.distance)[:2], target, atol=0.01)


def test_positive_yaw_turns_the_nose_to_the_image_right() -> None:
    assert pinhole(placed(Pose(yaw=20)), 12.0)[2, 0] > 64 + 3


def test_positive_pitch_looks_down() -> None:
    straight, down = (pinhole(placed(Pose(pitch=p)), 12.0) for p in (0, 15))
    assert down[2, 1] > straight[2, 1] + 2


def test_positive_roll_lifts_the_right_eye() -> None:
    seen = pinhole(placed(Pose(roll=10)), 12.0)
    assert seen[1, 1] < seen[0, 1] - 3


def test_placing_keeps_the_shape() -> None:
    points = placed(Pose(yaw=30, pitch=-10, roll=20))
    before = np.concatenate([EYES, NOSE, CHIN])
    ratio = np.linalg.norm(points[2] - points[3]) / np.linalg.norm(before[2] - before[3])
    assert np.linalg.norm(points[0] - points[1]) == pytest.approx(ratio * 0.6, rel=1e-12)


def test_project_is_the_pinhole() -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    np.testing.assert_allclose(project(points, CameraSpec(distance=7.0)), pinhole(points, 7.0), rtol=1e-12)
