from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.core.conventions import EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.faces.pose import Pose, camera_distance, place_head, project_points
from sfsnet_dr.scene.spec import CameraSpec, HeadSpec

#: A head of straws, decimetres: eyes, nose, chin, crown.
EYES = np.array([[-0.31, 7.28, 1.2], [0.31, 7.28, 1.2]])
NOSE, CHIN, CROWN = [0.0, 6.9, 1.5], [0.0, 6.1, 1.2], [0.0, 8.6, 0.4]
HEAD = np.vstack([EYES, NOSE, CHIN, CROWN])
WIDE = HeadSpec(yaw=60, pitch=30, roll=10, scale_jitter=0.1, shift_jitter=4)
LENSES = CameraSpec(focal=(26.0, 200.0))


def seen(pose: Pose) -> np.ndarray:
    """Pixels of the head's points."""
    camera = pose.camera(CameraSpec())
    return project_points(place_head(HEAD, EYES, pose, camera), camera)


@pytest.mark.parametrize("distance", [3.6, 12.0, 1000.0])
@pytest.mark.parametrize("pitch", [0.0, -30.0, 20.0])
def test_eyes_are_in_their_canonical_places(pitch: float, distance: float) -> None:
    pixels = seen(Pose(pitch=pitch, distance=distance))
    # ``place_head`` stops within 0.001 pixel.
    np.testing.assert_allclose(pixels[:2], [EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT], atol=1.5e-3)


@pytest.mark.parametrize("distance", [3.6, 12.0, 1000.0])
@pytest.mark.parametrize(("yaw", "pitch"), [(-35.0, 20.0), (60.0, 0.0), (60.0, -30.0)])
def test_a_turned_head_keeps_its_size(yaw: float, pitch: float, distance: float) -> None:
    pixels = seen(Pose(yaw=yaw, pitch=pitch, distance=distance))
    np.testing.assert_allclose(pixels[:2].mean(axis=0), (64.0, 48.0), atol=1.5e-3)
    assert pixels[1, 1] == pytest.approx(pixels[0, 1], abs=1.5e-3)
    assert 48.0 < pixels[3, 1] < 128.0  # the chin stays in the picture
    if (
        pitch == 0.0 and distance == 1000.0
    ):  # what is seen of the eyes' distance, and the chin's row from the front
        assert pixels[1, 0] - pixels[0, 0] == pytest.approx(38 * np.cos(np.radians(yaw)), rel=1e-3)
        assert pixels[3, 1] == pytest.approx(seen(Pose(distance=distance))[3, 1], rel=1e-3)


def test_signs_of_the_angles() -> None:
    straight = seen(Pose())
    assert straight[2, 0] == pytest.approx(64.0, abs=1e-2)
    assert seen(Pose(yaw=30.0))[2, 0] > 70.0  # the nose moves to the image right
    assert seen(Pose(pitch=20.0))[2, 1] > straight[2, 1]  # and looks down: it moves down
    left, right = seen(Pose(roll=10.0))[:2]
    assert left[1] > right[1]  # counter-clockwise: the image-left eye sinks
    slope = np.degrees(np.arctan2(left[1] - right[1], right[0] - left[0]))
    assert slope == pytest.approx(10.0, abs=1e-2)


def test_scale_and_shift() -> None:
    pixels = seen(Pose(scale=1.1, shift=(3.0, -2.0)))
    assert np.linalg.norm(pixels[1] - pixels[0]) == pytest.approx(38 * 1.1, abs=5e-3)
    middle = np.array([64.0, 48.0])
    expected = (middle - 64.0) * 1.1 + 64.0 + [3.0, -2.0]
    np.testing.assert_allclose(pixels[:2].mean(axis=0), expected, atol=2e-3)


def test_near_cameras_enlarge_the_nose_and_hide_the_crown() -> None:
    near, far = seen(Pose(distance=3.6)), seen(Pose(distance=28.0))

    def reach(pixels: np.ndarray, point: int) -> float:
        """From the middle of the picture, at which the camera looks."""
        return float(abs(pixels[point, 1] - 64.0))

    assert reach(near, 2) > 1.05 * reach(far, 2)
    assert reach(near, 4) < 0.9 * reach(far, 4)


def test_distances_follow_the_lens() -> None:
    # The view's 2 units fill 0.4 of 36 mm: similar triangles.
    assert camera_distance(36.0) == pytest.approx(5.0)
    assert camera_distance(200.0) / camera_distance(26.0) == pytest.approx(200 / 26)
    rng = np.random.default_rng(0)
    distances = np.array([Pose.sample(rng, WIDE, LENSES).distance for _ in range(2000)])
    assert camera_distance(26.0) <= distances.min() < 1.02 * camera_distance(26.0)
    assert 0.98 * camera_distance(200.0) < distances.max() <= camera_distance(200.0)
    # Log-uniform: the median is the geometric mean, 72 mm; 4 sigma of 2000 draws.
    assert np.median(distances) == pytest.approx(camera_distance(np.sqrt(26 * 200)), rel=0.1)
    assert Pose.sample(rng, WIDE, CameraSpec(distance=9.0)).distance == 9.0


def test_poses_stay_within_their_limits_and_reach_far() -> None:
    rng = np.random.default_rng(1)
    poses = [Pose.sample(rng, WIDE, LENSES) for _ in range(2000)]
    values = np.array([(p.yaw, p.pitch, p.roll, 100 * (p.scale - 1), *p.shift) for p in poses])
    limits = np.array([60, 30, 10, 10, 4, 4])
    assert np.all(np.abs(values) <= limits)
    assert np.all(np.abs(values).max(axis=0) > 0.95 * limits)
    # Standard deviations of a triangle and of a uniform density: limit / sqrt 6 and sqrt 3; 4 sigma of them.
    spread = values.std(axis=0) / limits
    np.testing.assert_allclose(spread, [6**-0.5] * 2 + [3**-0.5] * 4, rtol=0.06)
    for pose in poses[:200]:
        camera = pose.camera(LENSES)
        assert camera.focal is None
        assert np.isfinite(place_head(HEAD, EYES, pose, camera)).all()


def test_a_camera_in_the_face_is_refused() -> None:
    with pytest.raises(InputError, match=r"camera\.distance"):
        seen(Pose(yaw=60.0, distance=0.3))
