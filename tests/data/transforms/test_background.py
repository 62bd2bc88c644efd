from __future__ import annotations

import numpy as np

from sfsnet_dr.data.transforms.background import sample_background, sample_surroundings
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import Light, direction_from_angles
from sfsnet_dr.sh.projection import equirect_directions


def test_the_camera_sees_what_is_behind_the_face_upright_and_unmirrored() -> None:
    directions = equirect_directions(*MAP_SIZE)
    image = 2.0 + directions  # red grows to +x, green upward, blue toward the viewer
    got = sample_background(image, 3.0, 32)
    assert got[16, 30, 0] > got[16, 2, 0]  # image right is +x
    assert got[2, 16, 1] > got[30, 16, 1]  # row 0 is up
    # -z is straight ahead; bilinear interpolation of a unit vector: step^2 / 8 = 3.1e-4, and half a pixel.
    np.testing.assert_allclose(got[15:17, 15:17].mean(axis=(0, 1)), [2.0, 2.0, 1.0], atol=1e-3)
    # The picture's edge is 1 / 3 from the axis, less half a pixel.
    slope = (got[16, 31, 0] - 2) / (2 - got[16, 31, 2])
    np.testing.assert_allclose(slope, 31 / 32 / 3, rtol=5e-3)


def test_backgrounds_are_radiance_repeat_and_differ() -> None:
    light = Light("room", np.full((*MAP_SIZE, 3), 0.5), ((direction_from_angles(20, 20), np.full(3, 1.5)),))
    drawn = [sample_surroundings(np.random.default_rng(seed), light, 12.0, 16) for seed in range(40)]
    assert all(picture.shape == (16, 16, 3) and picture.min() >= 0 for picture in drawn)
    np.testing.assert_array_equal(drawn[3], sample_surroundings(np.random.default_rng(3), light, 12.0, 16))
    means = np.array([picture.mean() for picture in drawn])
    assert means.std() > 0.05
    assert means.max() < 1.0
    kinds = [picture.std(axis=(0, 1)).mean() / picture.mean() for picture in drawn]
    assert min(kinds) < 1e-6 < 0.3 < max(kinds)  # the even room, and things


def test_darkness_behind_a_single_lamp_is_no_trouble() -> None:
    lamp = Light("lamp", None, ((direction_from_angles(20, 20), np.full(3, 3.0)),))
    for seed in range(10):
        assert np.isfinite(sample_surroundings(np.random.default_rng(seed), lamp, 12.0, 8)).all()
