"""Captures as computations: labels, bytes, compiled kernels, nothing to see, and bad requests."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.bowls import DIRECTIONS, bowl_and_ball
from numpy.typing import NDArray

from sfsnet_dr.core import runtime
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.render.aovs import TransportOptions, render_aovs
from sfsnet_dr.scene.jit import dr
from sfsnet_dr.scene.mesh import NO_REGION, Region, bowl_mesh, sphere_mesh
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.spec import CameraSpec

Array = NDArray[np.floating]

SMALL = CameraSpec(size=32)
TINY = CameraSpec(size=24)
FULL = TransportOptions(order=4, bounces=3, paths=4)


@cache
def scene_of(gloss: bool) -> SurfaceScene:
    return SurfaceScene(bowl_and_ball(), TINY, gloss=gloss)


def test_regions_are_those_of_most_of_the_pixel() -> None:
    mesh = bowl_and_ball()
    on_ball = np.arange(len(mesh.vertices)) >= len(bowl_mesh().vertices)
    mesh = replace(mesh, regions=np.where(on_ball, Region.IRIS, Region.EAR).astype(np.uint8))
    maps = render_aovs(SurfaceScene(mesh, SMALL), 16, 0)
    labels = maps.regions
    assert set(np.unique(labels)) == {Region.EAR, Region.IRIS, NO_REGION}
    assert (labels[maps.coverage == 0] == NO_REGION).all()
    red = maps.albedo[..., 0]  # 0.3 on the bowl, 0.7 on the ball
    assert (labels[red > 0.52] == Region.IRIS).all()
    assert (labels[(red > 0) & (red < 0.48)] == Region.EAR).all()
    assert maps.mask.max() == 0  # neither is face skin


def test_bytes_do_not_depend_on_the_number_of_threads() -> None:
    threads = runtime.threads()
    try:
        runtime.set_threads(1)
        one = render_aovs(scene_of(True), 8, 3, FULL, DIRECTIONS)
        runtime.set_threads(3)
        three = render_aovs(scene_of(True), 8, 3, FULL, DIRECTIONS)
    finally:
        runtime.set_threads(threads)
    for name in ("normal", "albedo", "coverage", "transport", "gloss", "directional"):
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))
    assert one.rays == three.rays
    other = render_aovs(scene_of(True), 8, 4, FULL, DIRECTIONS)
    assert np.abs(one.transport - other.transport).max() > 1e-3


def test_a_second_face_compiles_nothing() -> None:
    """Another mesh, camera, seed, number of samples, of paths, and other lights: the kernels stay."""
    scene = SurfaceScene(bowl_and_ball(), SMALL, gloss=True)
    render_aovs(scene, 8, 0, FULL, DIRECTIONS)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for seed, shift in enumerate([(0.0, 0.2, 0.1), (-0.3, 0.0, 0.0), (0.1, 0.1, 0.1)]):
            scene.set_camera(replace(SMALL, distance=9.0 + seed))
            scene.set_mesh(bowl_and_ball(shift))
            render_aovs(scene, 5 + seed, seed, replace(FULL, paths=3 + seed), DIRECTIONS[[2, 0, 1]])
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert len(kernels) >= 3
    assert [kernel["hash"] for kernel in kernels if not kernel["cache_hit"]] == []


def test_an_empty_picture_is_black() -> None:
    aside = replace(sphere_mesh(), vertices=sphere_mesh().vertices + np.array([5.0, 0.0, 0.0]))
    maps = render_aovs(SurfaceScene(aside, TINY, gloss=True), 4, 0, FULL, DIRECTIONS)
    assert maps.transport.shape == (25, 24, 24, 3)
    assert maps.gloss.shape == (9, 24, 24)
    assert maps.directional.shape == (3, 24, 24, 3)
    assert not np.any(maps.transport)
    assert not np.any(maps.coverage)
    assert (maps.regions == NO_REGION).all()


def test_impossible_requests_are_refused() -> None:
    scene = scene_of(True)
    with pytest.raises(InputError, match="samples: 0 found"):
        render_aovs(scene, 0, 0)
    with pytest.raises(InputError, match="samples times paths: 80000 found"):
        render_aovs(scene, 20000, 0, FULL)
    with pytest.raises(InputError, match="samples times paths: 2 found, 3 lights need as many"):
        render_aovs(scene, 2, 0, TransportOptions(), DIRECTIONS)
    with pytest.raises(InputError, match="directions: lengths 2 to 2 found"):
        render_aovs(scene, 4, 0, FULL, 2 * DIRECTIONS[:1])
    with pytest.raises(InputError, match="sampler: 'halton'"):
        render_aovs(scene, 4, 0, TransportOptions(sampler="halton"))  # type: ignore[arg-type]
