"""Sun and sky against Mitsuba's own sampling of its emitter."""

from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.jit import dr, mi
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import direction_from_angles
from sfsnet_dr.scene.lights.sun_sky import sun_sky
from sfsnet_dr.sh.projection import equirect_directions, equirect_solid_angles

GRASS = np.array([0.1, 0.15, 0.05])


def sampled_irradiance(sun: np.ndarray, turbidity: float, normal: np.ndarray, count: int) -> np.ndarray:
    """(3,) irradiance of a surface by Mitsuba's importance sampling of a newly loaded emitter."""
    emitter = mi.load_dict(
        {
            "type": "sunsky",
            "sun_direction": [float(x) for x in sun],
            "turbidity": turbidity,
            "albedo": float(GRASS @ LUMINANCE),
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90),
        }
    )
    emitter.set_scene(mi.load_dict({"type": "scene", "ball": {"type": "sphere"}}))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, count)
    sample, weight = emitter.sample_direction(dr.zeros(mi.Interaction3f, count), sampler.next_2d())
    cosine = dr.maximum(dr.dot(sample.d, mi.Vector3f([float(x) for x in normal])), 0.0)
    return np.asarray(np.asarray(weight * cosine, dtype=np.float64).mean(axis=1))


@pytest.mark.parametrize(("elevation", "turbidity"), [(12.0, 2.0), (35.0, 3.5), (70.0, 8.0)])
def test_irradiance_is_that_of_mitsubas_sampler(elevation: float, turbidity: float) -> None:
    sun = direction_from_angles(30.0, elevation)
    light = sun_sky(sun, turbidity, GRASS)
    normal = direction_from_angles(10.0, 60.0)
    # The ground, which the plugin lacks, is left out.
    above = equirect_directions(*MAP_SIZE)
    cosine = equirect_solid_angles(*MAP_SIZE) * np.maximum(above @ normal, 0) * (above[..., 1] > 0)
    assert light.environment is not None
    baked = np.einsum("hw,hwc->c", cosine, light.environment)
    baked += (sun @ normal) * light.directional[0][1]
    # Texels of 2.8 degrees at the bright horizon, and the noise of 2^20 samples: 0.16 % seen, times 3.
    np.testing.assert_allclose(baked, sampled_irradiance(sun, turbidity, normal, 1 << 20), rtol=0.005)


def test_the_ground_reflects_what_falls_on_it() -> None:
    sun = direction_from_angles(0.0, 40.0)
    light = sun_sky(sun, 3.0, GRASS)
    assert light.environment is not None
    arriving = sampled_irradiance(sun, 3.0, direction_from_angles(0.0, 90.0), 1 << 20)
    np.testing.assert_allclose(light.environment[-1, 0], GRASS * arriving / np.pi, rtol=0.005)  # as above


def test_settings_do_not_linger() -> None:
    first = sun_sky(direction_from_angles(30.0, 20.0), 3.0, GRASS)
    sun_sky(direction_from_angles(-100.0, 70.0), 9.0, np.ones(3))
    again = sun_sky(direction_from_angles(30.0, 20.0), 3.0, GRASS)
    np.testing.assert_array_equal(first.environment, again.environment)
    np.testing.assert_array_equal(first.directional[0][1], again.directional[0][1])


def test_sky_and_ground_are_where_they_belong() -> None:
    light = sun_sky(direction_from_angles(0.0, 30.0), 3.0, GRASS)
    assert light.environment is not None
    zenith, nadir = light.environment[0, 0], light.environment[-1, 0]
    assert zenith[2] > zenith[0]  # blue above
    np.testing.assert_allclose(nadir[1] / nadir[0], 1.5, atol=0.2)  # grass below
    front, back = light.environment[24, 64], light.environment[24, 0]
    assert front @ LUMINANCE > 1.5 * (back @ LUMINANCE)  # the sky is bright around the sun


def test_a_low_sun_is_red_and_weak() -> None:
    low, high = (sun_sky(direction_from_angles(0.0, e), 3.0, GRASS).directional[0][1] for e in (3.0, 60.0))
    assert low[2] / low[0] < 0.2 < high[2] / high[0]
    assert low @ LUMINANCE < 0.5 * (high @ LUMINANCE)
    assert low.min() >= 0


def test_clouds_take_the_sun() -> None:
    shut = sun_sky(direction_from_angles(0.0, 40.0), 5.0, GRASS, sunshine=0.0)
    half = sun_sky(direction_from_angles(0.0, 40.0), 5.0, GRASS, sunshine=0.5)
    full = sun_sky(direction_from_angles(0.0, 40.0), 5.0, GRASS)
    assert shut.directional == ()
    np.testing.assert_allclose(half.directional[0][1], full.directional[0][1] / 2, rtol=1e-12)
    assert shut.environment is not None
    assert full.environment is not None
    assert shut.environment[-1, 0, 0] < full.environment[-1, 0, 0]  # less light on the ground


@pytest.mark.parametrize(
    ("elevation", "turbidity", "ground", "sunshine", "words"),
    [
        (-5.0, 3.0, 0.1, 1.0, "elevation"),
        (40.0, 0.5, 0.1, 1.0, "turbidity"),
        (40.0, 3.0, 1.5, 1.0, "ground"),
        (40.0, 3.0, 0.1, 2.0, "sunshine"),
    ],
)
def test_bad_settings(elevation: float, turbidity: float, ground: float, sunshine: float, words: str) -> None:
    with pytest.raises(InputError, match=words):
        sun_sky(direction_from_angles(0.0, elevation), turbidity, np.full(3, ground), sunshine)
