"""Banks of lights: the same whoever draws them, and kept only as long as they are what is asked for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.image_io import write_exr
from sfsnet_dr.scene.lights import cache
from sfsnet_dr.scene.lights.cache import draw_lights, light_cache_of, light_fingerprint, load_or_draw_lights
from sfsnet_dr.scene.lights.light import Light, direction_from_angles
from sfsnet_dr.scene.lights.spec import LightSpec

QUICK = LightSpec(hdr=0, sun_sky=0, studio=0, directional=1, ambient=0, lobes=1)


def test_light_n_depends_on_the_seed_and_n_alone() -> None:
    long, short = draw_lights(QUICK, 8, seed=3), draw_lights(QUICK, 5, seed=3)
    np.testing.assert_array_equal(long.radiance[:5], short.radiance)
    np.testing.assert_array_equal(long.power[:5], short.power)
    assert not np.array_equal(draw_lights(QUICK, 5, seed=4).radiance, short.radiance)
    assert 0 < long.free.sum() < 8
    # Lamps of a studio are free, lobes have none.
    np.testing.assert_array_equal(long.power.any(axis=(1, 2)), long.free)


def test_a_light_is_kept_as_map_coefficients_and_lamps() -> None:
    lamps = (
        (direction_from_angles(20.0, 30.0), np.array([1.0, 2.0, 3.0])),
        (direction_from_angles(-90.0, 0.0), np.ones(3)),
    )
    light = Light("both", np.full((64, 128, 3), 0.5), lamps)
    bank = light_cache_of([(light, False)])
    np.testing.assert_allclose(bank.radiance[0], light.environment_coefficients().values)
    np.testing.assert_allclose(bank.toward[0, :2], [lamps[0][0], lamps[1][0]])
    np.testing.assert_allclose(bank.power[0], [[1, 2, 3], [1, 1, 1], [0, 0, 0], [0, 0, 0]])


def test_a_kept_bank_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, drawn = tmp_path / "lights.npz", []
    first = load_or_draw_lights(path, QUICK, 4, 0, lambda: drawn.append(1))
    assert len(drawn) == 4
    with monkeypatch.context() as patch:
        patch.setattr(cache, "draw_lights", None)
        again = load_or_draw_lights(path, QUICK, 4, 0)
    for name in ("radiance", "toward", "power", "free"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert first.fingerprint == again.fingerprint


def test_another_or_damaged_bank_is_drawn_anew(tmp_path: Path) -> None:
    path = tmp_path / "lights.npz"
    load_or_draw_lights(path, QUICK, 4, 0)
    assert len(load_or_draw_lights(path, QUICK, 3, 0)) == 3
    assert len(load_or_draw_lights(path, replace(QUICK, lobes=0.0), 4, 0)) == 4
    path.write_bytes(path.read_bytes()[:100])
    assert len(load_or_draw_lights(path, QUICK, 4, 0)) == 4
    path.write_bytes(b"")
    assert len(load_or_draw_lights(path, QUICK, 4, 0)) == 4


def test_maps_count_by_their_bytes_not_their_place(tmp_path: Path) -> None:
    maps = {name: tmp_path / name for name in ("a", "b")}
    for level, folder in zip((1.0, 1.0), maps.values(), strict=True):
        folder.mkdir()
        write_exr(folder / "map.exr", dict.fromkeys("RGB", np.full((16, 32), level, np.float32)), {})
    a, b = (replace(QUICK, hdr=1.0, environments=str(folder)) for folder in maps.values())
    assert light_fingerprint(a, 4, 0) == light_fingerprint(b, 4, 0)
    write_exr(maps["b"] / "map.exr", dict.fromkeys("RGB", np.full((16, 32), 2.0, np.float32)), {})
    assert light_fingerprint(a, 4, 0) != light_fingerprint(b, 4, 0)
    with pytest.raises(InputError, match="no such folder"):
        draw_lights(replace(QUICK, environments=str(tmp_path / "none")), 1, 0)
