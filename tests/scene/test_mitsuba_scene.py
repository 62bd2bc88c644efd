"""Scenes whose parts are exchanged in place, against scenes built anew, seen by Mitsuba's own camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.bowls import DIRECTIONS, bowl_and_ball
from numpy.typing import NDArray

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.jit import dr, mi, upload_array
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.mesh import sphere_mesh
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.spec import CameraSpec

Array = NDArray[np.float64]

CAMERA = CameraSpec(size=24)
RED, BLUE = np.array([3.0, 0.5, 0.5]), np.array([0.5, 0.5, 3.0])


def rendered(scene: SurfaceScene) -> Array:
    integrator = mi.load_dict({"type": "path", "max_depth": 4, "hide_emitters": True})
    image = mi.render(scene.mi_scene, integrator=integrator, spp=16, seed=3)
    return np.asarray(image, dtype=np.float64)[..., :3]


@pytest.mark.parametrize("gloss", [False, True])
def test_an_exchanged_scene_is_the_one_built_anew(gloss: bool) -> None:
    """Mesh, camera and lights at once: the same seed gives the same picture, but for rounding."""
    sky = np.linspace(0.2, 1.0, MAP_SIZE[1])[None, :, None] * np.ones((*MAP_SIZE, 3))
    first = SurfaceScene(
        bowl_and_ball(), CAMERA, [(DIRECTIONS[0], RED), (DIRECTIONS[1], RED)], environment=True, gloss=gloss
    )
    rendered(first)
    there = bowl_and_ball((-0.2, 0.0, 0.1))
    near, lights = CameraSpec(size=24, distance=5.0), [(DIRECTIONS[2], BLUE), (DIRECTIONS[0], RED)]
    first.set_mesh(there)
    first.set_camera(near)
    first.set_directional(lights)
    first.set_environment(sky)
    anew = SurfaceScene(there, near, lights, environment=True, gloss=gloss)
    anew.set_environment(sky)
    # The two sensors and light frames are made in other ways: float32 rounding, which may move a ray over an
    # edge; so that a pixel or two of 576 may differ.
    difference = np.abs(rendered(first) - rendered(anew)).max(axis=-1)
    assert np.quantile(difference, 0.98) < 1e-4
    assert difference.mean() < 1e-3
    stale = SurfaceScene(there, CAMERA, lights, environment=True, gloss=gloss)
    stale.set_environment(sky)
    assert np.abs(rendered(stale) - rendered(anew)).mean() > 0.01  # a camera that stayed would be seen


def test_triangles_are_exchanged_with_the_mesh() -> None:
    ball = sphere_mesh(rings=16)
    scene = SurfaceScene(ball, CAMERA)
    scene.set_environment(1.0)
    lit = rendered(scene).mean()
    scene.set_mesh(replace(ball, faces=np.ascontiguousarray(ball.faces[:, ::-1]), normals=-ball.normals))
    assert lit > 0.1
    # Turned inside out, it is seen from behind; at the outline some facets show a little of their front.
    assert rendered(scene).mean() < 1e-3 * lit


def test_what_a_scene_was_not_made_for_is_refused() -> None:
    scene = SurfaceScene(sphere_mesh(), CAMERA, [(DIRECTIONS[0], RED)])
    with pytest.raises(InputError, match=r"camera\.size: 32 found, 24 expected"):
        scene.set_camera(CameraSpec(size=32))
    with pytest.raises(InputError, match="directional: 2 lights found, 1 expected"):
        scene.set_directional([(DIRECTIONS[0], RED)] * 2)
    with pytest.raises(InputError, match="directional lights only"):
        scene.set_environment(1.0)
    with pytest.raises(InputError, match="vertices"):
        scene.set_mesh(bowl_and_ball())
    assert scene.fits(sphere_mesh(), replace(CAMERA, distance=3.0))
    assert not scene.fits(sphere_mesh(), CameraSpec(size=32))


def test_uploaded_arrays_are_aligned_whatever_numpy_gave() -> None:
    memory = np.arange(1000, dtype=np.float32)
    for shift in range(8):
        array = upload_array(mi.Float, memory[shift:].reshape(-1, 1))
        np.testing.assert_array_equal(np.asarray(array), memory[shift:])
        assert dr.width(array) == 1000 - shift
        assert np.asarray(array).ctypes.data % 64 == 0
