from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.image_io import write_exr
from sfsnet_dr.scene.lights.equirect import pixel_directions
from sfsnet_dr.scene.lights.light import SNAP_DEG, direction_from_angles
from sfsnet_dr.scene.lights.sampling import (
    LARGEST_ANGLE,
    draw_kind,
    sample_direction,
    sample_scene_light,
    turn_to,
)
from sfsnet_dr.scene.lights.spec import LightKind, LightSpec
from sfsnet_dr.scene.spec import load_scene

KINDS: list[LightKind] = ["hdr", "sun_sky", "studio", "directional", "ambient", "lobes"]
NONE = LightSpec(hdr=0, sun_sky=0, studio=0, directional=0, ambient=0, lobes=0)


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> LightSpec:
    """Two maps: a plain sky, and one with a sun 40 degrees above the horizon."""
    folder = tmp_path_factory.mktemp("maps")
    plain = (1 + 0.5 * pixel_directions(32, 64)[..., 1:2]) * np.array([0.5, 0.6, 0.8])
    sunny = plain.copy()
    sunny[8, 20] = 500.0
    for name, picture in (("plain", plain), ("sunny", sunny)):
        write_exr(folder / f"{name}.exr", {c: picture[..., k] for k, c in enumerate("RGB")}, {})
    return LightSpec(environments=str(folder))


def only(kind: LightKind, spec: LightSpec) -> LightSpec:
    weight: dict[str, Any] = {kind: 1.0}
    return replace(NONE, environments=spec.environments, **weight)


def fan() -> np.ndarray:
    """Eight directions as a bundle has them."""
    rng = np.random.default_rng(5)
    return np.stack([sample_direction(rng) for _ in range(8)])


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_exposed_and_repeatable(kind: LightKind, maps: LightSpec) -> None:
    spec = only(kind, maps)
    levels = []
    for seed in range(12):
        light = sample_scene_light(np.random.default_rng(seed), spec)
        again = sample_scene_light(np.random.default_rng(seed), spec)
        np.testing.assert_array_equal(light.coefficients(4).values, again.coefficients(4).values)
        levels.append(light.face_shading() @ LUMINANCE)
    low, high = spec.exposure
    assert low * (1 - 1e-9) <= min(levels)
    assert max(levels) <= high * (1 + 1e-9)
    assert np.std(levels) > 0.05


@pytest.mark.parametrize("kind", KINDS)
def test_hard_light_comes_from_the_given_directions(kind: LightKind, maps: LightSpec) -> None:
    directions, hard = fan(), 0
    for seed in range(12):
        light = sample_scene_light(np.random.default_rng(seed), only(kind, maps), directions)
        for toward, _ in light.directional:
            hard += 1
            assert (directions @ toward).max() >= np.cos(np.radians(SNAP_DEG)) - 1e-12
    if kind in ("sun_sky", "directional"):
        assert hard >= 6


def test_lamps_stay_within_85_degrees_and_reach_there(maps: LightSpec) -> None:
    rng = np.random.default_rng(0)
    angles = [
        np.degrees(np.arccos(toward[2]))
        for _ in range(200)
        for toward, _ in draw_kind("directional", rng, maps).directional
    ]
    assert 80 < max(angles) <= LARGEST_ANGLE
    # Uniform in solid angle: half lie beyond acos((1 + cos 85) / 2) = 57.1 degrees; 4 sigma of 310 lamps.
    assert np.mean(np.array(angles) > 57.1) == pytest.approx(0.5, abs=0.115)


def test_the_number_of_lamps_varies(maps: LightSpec) -> None:
    rng = np.random.default_rng(1)
    counts = {len(draw_kind("directional", rng, maps).directional) for _ in range(40)}
    assert counts == {1, 2, 3}
    assert len(draw_kind("directional", rng, maps, fan()[:1]).directional) == 1


@pytest.mark.parametrize("tilt", [-20.0, 0.0, 25.0])
def test_turn_to_brings_a_direction_to_another(tilt: float) -> None:
    start, target = direction_from_angles(100.0, 30.0), direction_from_angles(-20.0, 30.0 + tilt)
    turn = turn_to(start, target)
    np.testing.assert_allclose(turn @ start, target, atol=1e-12)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert turn[1, 1] == pytest.approx(np.cos(np.radians(tilt)))  # up stays up but for the tilt


def test_surroundings_turn_their_sun_to_a_direction(maps: LightSpec) -> None:
    target = direction_from_angles(50.0, 30.0)
    suns = [
        light.directional[0][0]
        for seed in range(10)
        if (light := draw_kind("hdr", np.random.default_rng(seed), maps, target[None])).directional
    ]
    assert suns
    for sun in suns:
        np.testing.assert_allclose(sun, target, atol=1e-9)
    # From far below the horizon no sun shines: the map is not turned over, and the light is made soft.
    below = direction_from_angles(50.0, -60.0)[None]
    for seed in range(6):
        light = sample_scene_light(np.random.default_rng(seed), only("hdr", maps), below)
        assert light.directional == ()


def test_without_a_folder_other_kinds_are_drawn() -> None:
    assert "hdr" not in LightSpec().weights()
    names = {sample_scene_light(np.random.default_rng(seed), LightSpec()).name for seed in range(30)}
    assert {"studio", "directional", "sun_sky"} <= names
    with pytest.raises(InputError, match="environments"):
        draw_kind("hdr", np.random.default_rng(0), LightSpec())
    with pytest.raises(InputError, match="weight"):
        sample_scene_light(np.random.default_rng(0), replace(NONE, hdr=1.0))


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    spec = replace(NONE, hdr=1.0, environments=str(tmp_path / "none"))
    with pytest.raises(InputError, match="none"):
        sample_scene_light(np.random.default_rng(0), spec)


def test_a_scene_file_says_which_lights(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    head = 'name = "x"\nshape = "anny"\n[camera]\nfocal = [26, 200]\n[light]\n'
    path.write_text(head + 'studio = 2.0\nenvironments = "maps"\nexposure = [0.3, 0.9]\n')
    spec = load_scene(path)
    assert spec.light == replace(LightSpec(), studio=2.0, environments="maps", exposure=(0.3, 0.9))
    assert spec.camera.focal == (26.0, 200.0)
    for line, words in (
        ("studio = -1.0", r"light\.studio"),
        ("exposure = [0.0, 1.0]", r"light\.exposure\[0\]"),
        ("white_balance = [0.5, 2.0]", r"light\.white_balance\[1\]"),
        ("sunny = 1.0", "sun_sky|allowed"),
    ):
        path.write_text(head + line)
        with pytest.raises(InputError, match=words):
            load_scene(path)
