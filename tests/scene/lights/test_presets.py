"""The lights for judging renderers: stable names, what each holds, equal exposure, and bad requests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.image_io import write_exr
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.lights.presets import (
    EXPOSURE,
    describe_light,
    directional_light,
    light_set,
    light_sets,
    require_light,
)
from sfsnet_dr.sh.kernel import band_of

NAMES = [
    "constant", "band1", "band2", "band3", "band4", "natural0", "natural1", "natural2", "studio", "overcast",
    "directional0", "directional30", "directional60", "directional85", "sun_sky", "two_colours",
]  # fmt: skip


def test_all_lights_have_their_names_and_one_exposure() -> None:
    lights = light_set("all")
    assert [light.name for light in lights] == NAMES
    for light in lights:
        assert light.face_shading() @ LUMINANCE == pytest.approx(EXPOSURE, rel=1e-9)
        assert require_light(light) is light
        assert "map" not in describe_light(light)
        assert "lamps" not in describe_light(light)


def test_sets_and_single_lights_combine_in_a_fixed_order() -> None:
    assert [light.name for light in light_set("directional60,bands,constant")] == [
        "constant", "band1", "band2", "band3", "band4", "directional60",
    ]  # fmt: skip
    assert set(light_sets()["standard"]) < set(NAMES)


@pytest.mark.parametrize("band", [1, 2, 3, 4])
def test_a_band_is_a_constant_and_that_band_alone(band: int) -> None:
    [light] = light_set(f"band{band}")
    values = light.coefficients(6).values[:, 0]
    power = np.array([np.linalg.norm(values[band_of(6) == k]) for k in range(7)])
    assert power[[0, band]].min() > 0.1 * power[0]
    # The map's texels of 2.8 degrees interpolate the harmonic: a hat loses (2.8 / 57.3)^2 l (l + 1) / 12.
    assert np.delete(power, [0, band]).max() < 3e-3 * power[0]
    assert light.environment is not None
    assert light.environment.min() < 1e-3 * light.environment.max()


@pytest.mark.parametrize("angle", [0, 30, 60, 85])
def test_a_directional_light_stands_where_its_name_says(angle: int) -> None:
    [(toward, _)] = directional_light(angle).directional
    assert np.degrees(np.arccos(toward[2])) == pytest.approx(angle, abs=1e-6)
    assert toward[0] >= 0
    assert toward[1] >= 0


def test_maps_of_a_folder_join(tmp_path: Path) -> None:
    write_exr(tmp_path / "My Room-2.exr", dict.fromkeys("RGB", np.ones((16, 32), np.float32)), {})
    assert [x.name for x in light_set("environments", tmp_path)][-1] == "map_my_room_2"
    assert describe_light(light_set("map_my_room_2", tmp_path)[0]) == "a map"
    assert light_set("map_my_room_2", tmp_path)[0].coefficients(0).values[0, 0] > 0
    write_exr(tmp_path / "my_room 2.exr", dict.fromkeys("RGB", np.ones((16, 32), np.float32)), {})
    with pytest.raises(InputError, match="two environment maps named 'map_my_room_2'"):
        light_set("all", tmp_path)


def test_wrong_lights_are_refused() -> None:
    with pytest.raises(InputError, match="light 'directionl60': unknown; did you mean 'directional60'"):
        light_set("constant,directionl60")
    with pytest.raises(InputError, match="light 'night': all zeros found"):
        require_light(Light("night", np.zeros((*MAP_SIZE, 3))))
    with pytest.raises(InputError, match="light 'off': all zeros found"):
        require_light(Light("off", None, ((np.array([0.0, 0.0, 1.0]), np.zeros(3)),)))
