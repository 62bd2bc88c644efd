"""Scenes that are kept: the right surface and light is shown, and none is built twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from sfsnet_dr.render.path_tracer import path_trace
from sfsnet_dr.scene import scene_cache
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.mesh import SHAPES, Mesh
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.scene_cache import SceneCache
from sfsnet_dr.scene.spec import CameraSpec

CAMERA = CameraSpec(size=8)
GREY, RED = SHAPES["sphere"]((0.5, 0.5, 0.5)), SHAPES["sphere"]((0.8, 0.1, 0.1))
WHITE = Light("white", np.ones((*MAP_SIZE, 3)))
DIM = Light("dim", np.full((*MAP_SIZE, 3), 0.25))
TOWARD = (np.array([0.0, 0.0, 1.0]), np.full(3, np.pi))
LAMP, LAMPS = Light("lamp", None, (TOWARD,)), Light("lamps", None, (TOWARD, TOWARD))
BOTH = Light("both", WHITE.environment, (TOWARD,))


def image(scene: SurfaceScene) -> npt.NDArray[np.float64]:
    return path_trace(scene, 4, 0, 2).mean


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[Mesh]:
    """Meshes of the scenes that were built, in order."""
    meshes: list[Mesh] = []

    def build(mesh: Mesh, *args: object, **kwargs: object) -> SurfaceScene:
        meshes.append(mesh)
        return SurfaceScene(mesh, *args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(scene_cache, "SurfaceScene", build)
    return meshes


def test_what_is_kept_shows_the_same_as_a_new_scene(built: list[Mesh]) -> None:
    scenes = SceneCache()
    order = [(GREY, WHITE), (RED, DIM), (GREY, LAMP), (RED, LAMPS), (GREY, DIM), (RED, LAMP), (GREY, BOTH)]
    for mesh, light in order:
        new = SceneCache().show(mesh, CAMERA, light, gloss=False)
        expected = image(new)
        assert expected.max() > 0
        np.testing.assert_array_equal(image(scenes.show(mesh, CAMERA, light, gloss=False)), expected)
    assert len(built) == len(order) + 4  # one for a map, one and two lamps, and both


def test_the_camera_moves_with_the_surface() -> None:
    scenes = SceneCache()
    near = replace(CAMERA, distance=4.0)
    first = image(scenes.show(GREY, CAMERA, WHITE, gloss=False))
    assert not np.array_equal(image(scenes.show(GREY, near, WHITE, gloss=False)), first)
    np.testing.assert_array_equal(image(scenes.show(GREY, CAMERA, WHITE, gloss=False)), first)


def test_gloss_is_a_scene_of_its_own(built: list[Mesh]) -> None:
    scenes = SceneCache()
    for gloss in (False, True, False, True):
        assert scenes.show(GREY, CAMERA, WHITE, gloss=gloss).gloss == gloss
    assert len(built) == 2


def test_the_least_recently_used_is_dropped(built: list[Mesh]) -> None:
    scenes = SceneCache(capacity=2)
    for light in (WHITE, LAMP, WHITE, LAMPS, WHITE, LAMP):
        scenes.show(GREY, CAMERA, light, gloss=False)
    assert len(built) == 4  # map, lamp, lamps; then the lamp again
