"""Lights before a batch of faces, against the same steps done one light at a time on maps."""

from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.scene.lights.batch import light_faces, turns_to
from sfsnet_dr.scene.lights.cache import draw_lights, light_cache_of
from sfsnet_dr.scene.lights.light import Light, direction_from_angles
from sfsnet_dr.scene.lights.sampling import sample_direction, turn_to
from sfsnet_dr.scene.lights.spec import LightSpec
from sfsnet_dr.scene.lights.vmf_lobes import sample_lights
from sfsnet_dr.sh.rotation import rotate_each, rotation_matrix

#: One exposure and full white balance: nothing is left to chance but which lamp goes where.
FIXED = LightSpec(exposure=(0.6, 0.6), white_balance=(1.0, 1.0))
DIRECTIONS = np.stack([direction_from_angles(40.0, 20.0), direction_from_angles(-30.0, 5.0)])


def sky(seed: int) -> np.ndarray:
    """A smooth map."""
    return sample_lights(np.random.default_rng(seed), 1)[0].equirect(64, 128)


def test_turns_and_rotations_are_those_of_one_light() -> None:
    rng = np.random.default_rng(0)
    toward, target = (np.array([sample_direction(rng) for _ in range(20)]) for _ in range(2))
    turns = turns_to(toward, target)
    np.testing.assert_allclose(
        turns, [turn_to(a, b) for a, b in zip(toward, target, strict=True)], atol=1e-12
    )
    np.testing.assert_allclose(np.einsum("nij,nj->ni", turns, toward), target, atol=1e-12)
    values = rng.normal(size=(20, 25, 3))
    expected = [rotation_matrix(turn, 4) @ value for turn, value in zip(turns, values, strict=True)]
    np.testing.assert_allclose(rotate_each(values, turns), expected, atol=1e-12)


def test_a_light_that_stands_right_is_balanced_exposed_and_labelled_as_on_maps() -> None:
    lamps = (
        (DIRECTIONS[0], np.array([3.0, 2.0, 1.0])),
        (direction_from_angles(-100.0, -20.0), np.array([1.0, 1.0, 2.0])),
    )
    light = Light("sun and lamp", sky(1), lamps)
    found = light_faces(
        np.random.default_rng(0), light_cache_of([(light, False)]), DIRECTIONS[None, :1], FIXED
    )
    expected = light.softened(DIRECTIONS[:1]).balanced(1.0).exposed(0.6)
    np.testing.assert_allclose(found.irradiance[0, 0], expected.directional[0][1], rtol=2e-3)
    # The softened lamp's lobe is sampled on a map of 2.8 degrees there and exact here.
    coefficients = expected.environment_coefficients().values
    np.testing.assert_allclose(found.radiance[0], coefficients, atol=3e-3 * np.abs(coefficients).max())
    np.testing.assert_allclose(found.label[0], expected.shading_label().values, atol=3e-3)
    np.testing.assert_allclose(found.level[0], expected.face_shading(), rtol=2e-3)
    assert found.level[0] @ LUMINANCE == pytest.approx(0.6)


def test_surroundings_turn_with_their_sun() -> None:
    sun = direction_from_angles(170.0, 12.0)
    light = Light("sun", sky(2), ((sun, np.array([2.0, 2.0, 2.0])),))
    directions = np.tile(DIRECTIONS, (64, 1, 1))
    found = light_faces(np.random.default_rng(0), light_cache_of([(light, False)]), directions, FIXED)
    chosen = (found.irradiance.sum(axis=-1) > 0).astype(int)
    np.testing.assert_array_equal(chosen.sum(axis=1), 1)
    assert 10 < chosen[:, 0].sum() < 54
    for place in (0, 1):
        row = int(np.flatnonzero(chosen[:, place])[0])
        turned = light.turned(turn_to(sun, DIRECTIONS[place])).balanced(1.0).exposed(0.6)
        # ``turned`` blurs by half a texel.
        np.testing.assert_allclose(found.label[row], turned.shading_label().values, atol=5e-3)


def test_a_sun_that_no_direction_is_high_enough_for_becomes_soft() -> None:
    light = Light("noon", np.full((64, 128, 3), 0.2), ((direction_from_angles(0.0, 60.0), np.ones(3)),))
    found = light_faces(np.random.default_rng(0), light_cache_of([(light, False)]), DIRECTIONS[None], FIXED)
    assert not found.irradiance.any()
    expected = light.softened(DIRECTIONS).exposed(0.6)
    np.testing.assert_allclose(found.label[0], expected.shading_label().values, atol=3e-3)


def test_lamps_of_a_studio_come_from_the_faces_directions() -> None:
    lamps = tuple(
        (direction_from_angles(angle, 0.0), np.full(3, power)) for angle, power in ((10.0, 2.0), (70.0, 1.0))
    )
    bank = light_cache_of([(Light("two", np.full((64, 128, 3), 0.1), lamps), True)])
    directions = np.array(
        [[sample_direction(np.random.default_rng(k + 9 * b)) for k in range(6)] for b in range(40)]
    )
    found = light_faces(np.random.default_rng(0), bank, directions, FIXED)
    power = np.sort(found.irradiance[..., 1], axis=1)
    np.testing.assert_allclose(power[:, :4], 0.0)
    np.testing.assert_allclose(power[:, 5] / power[:, 4], 2.0)
    assert len(np.unique(found.irradiance[..., 1].argmax(axis=1))) == 6
    # With one direction the second lamp is soft; without any, both are.
    one = light_faces(np.random.default_rng(0), bank, directions[:, :1], FIXED)
    assert (one.irradiance > 0).all()
    none = light_faces(np.random.default_rng(0), bank, directions[:, :0], FIXED)
    assert none.irradiance.shape == (40, 0, 3)
    np.testing.assert_allclose(none.level @ LUMINANCE, 0.6)


def test_exposures_spread_over_their_range() -> None:
    bank = draw_lights(LightSpec(hdr=0, sun_sky=0, studio=0, directional=1, ambient=0, lobes=1), 6, 0)
    spec = LightSpec(exposure=(0.25, 1.0), white_balance=(0.0, 1.0))
    level = (
        light_faces(np.random.default_rng(0), bank, np.tile(DIRECTIONS, (400, 1, 1)), spec).level @ LUMINANCE
    )
    assert 0.25 <= level.min() < 0.27
    assert 0.93 < level.max() <= 1.0
    assert np.median(level) == pytest.approx(0.5, rel=0.15)  # log-uniform; 4 standard deviations
