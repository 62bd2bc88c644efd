"""Relit transport against the path tracer, and what physics says stays when scene and light move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from helpers.bowls import DIRECTIONS, bowl_and_ball, turned
from helpers.ztest import z_test
from numpy.typing import NDArray

from sfsnet_dr.data.transforms.mirror import mirror_transport
from sfsnet_dr.metrics.noise_free import bias_squared
from sfsnet_dr.render.aovs import TransportMaps, TransportOptions, render_aovs
from sfsnet_dr.render.path_tracer import path_trace
from sfsnet_dr.render.transport_shading import ResponseWeights, relight_responses
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.spec import CameraSpec
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.projection import equirect_directions, project_equirect
from sfsnet_dr.sh.rotation import rotation_matrix

Array = NDArray[np.float64]
Image = NDArray[np.floating]

TINY = CameraSpec(size=24)
FULL = TransportOptions(order=4, bounces=3, paths=4)


def averaged(
    scene: SurfaceScene, runs: int, directions: Array | None = None, samples: int = 16
) -> list[TransportMaps]:
    """Captures of independent seeds."""
    return [render_aovs(scene, samples, seed, FULL, directions) for seed in range(runs)]


def mean_and_variance(images: Sequence[Image]) -> tuple[Array, Array]:
    """Mean over runs, and the variance of that mean."""
    stack = np.stack([image.astype(np.float64) for image in images])
    return stack.mean(axis=0), stack.var(axis=0, ddof=1) / len(stack)


@cache
def scene_of(gloss: bool) -> SurfaceScene:
    return SurfaceScene(bowl_and_ball(), TINY, gloss=gloss)


def smooth_sky() -> tuple[Array, Array]:
    """A positive environment of order 2, and its coefficients to order 4 as Mitsuba interpolates it."""
    coefficients = np.zeros((9, 3))
    coefficients[:4] = [[3.0, 2.5, 2.0], [0.5, 0.6, 0.7], [0.6, 0.2, 0.4], [0.4, 0.7, 0.2]]
    coefficients[5] = 0.3
    sky = sh_basis(equirect_directions(*MAP_SIZE), 2) @ coefficients
    assert sky.min() > 0
    return sky, project_equirect(sky, 4).values


@pytest.mark.parametrize("gloss", [False, True])
def test_relit_images_are_the_path_tracers(gloss: bool) -> None:
    """Under a sky that order 2 holds wholly, and one of the lamps, nothing is truncated but the bounces."""
    sky, radiance = smooth_sky()
    irradiance = np.array([2.0, 1.0, 3.0])
    lit = SurfaceScene(bowl_and_ball(), TINY, [(DIRECTIONS[1], irradiance)], environment=True, gloss=gloss)
    lit.set_environment(sky)
    light = ResponseWeights(radiance, np.outer([0.0, 1.0, 0.0], irradiance))
    runs = averaged(scene_of(gloss), 48, DIRECTIONS)
    image, variance = mean_and_variance(
        [relight_responses(maps.transport, maps.gloss, maps.directional, light) for maps in runs]
    )
    first, second = (path_trace(lit, 2048, seed, depth=5) for seed in (1, 2))
    reference, noise = (first.mean + second.mean) / 2, (first.variance + second.variance) / 4
    covered = runs[0].coverage == 1
    # What bilinear texels hold beyond order 4 of this sky is below 1e-4 of its radiance.
    result = z_test(image, variance, reference, noise, mask=covered, allowance=2e-4)
    assert result.passed, result
    # The whole squared error, free of the references' noise, less the transport's own: what is systematic.
    # Seen 8e-6 of the image's power for both, with an uncertainty of 1.4e-5 (bootstrap), times 3.
    squared = bias_squared(image, first.mean, second.mean, covered.astype(float))
    systematic = (squared - variance[covered].mean()) / (reference[covered] ** 2).mean()
    assert systematic < 4e-5
    excess = (image - reference)[covered].mean(axis=0)
    error = np.sqrt((variance + noise)[covered].sum(axis=0)) / covered.sum()
    assert (np.abs(excess) < 4.5 * error).all()
    assert (error / reference[covered].mean(axis=0) < 1e-3).all()
    planted = {
        "one per cent": image * 1.01,
        "no lamp": image - np.einsum("hwc,c->hwc", runs[0].directional[1], irradiance),
        "light seen directly alone": relit_without_bounces(gloss, light),
    }
    if gloss:
        planted["no gloss"] = image - relight_responses(
            0 * runs[0].transport, runs[0].gloss, 0 * runs[0].directional, light
        )
    for name, wrong in planted.items():
        assert not z_test(wrong, variance, reference, noise, mask=covered, allowance=2e-4).passed, name


def relit_without_bounces(gloss: bool, light: ResponseWeights) -> Array:
    options = replace(FULL, bounces=0)
    maps = [render_aovs(scene_of(gloss), 16, seed, options, DIRECTIONS) for seed in range(16)]
    return np.asarray(
        np.mean([relight_responses(m.transport, m.gloss, m.directional, light) for m in maps], axis=0)
    )


def test_the_share_beyond_the_last_bounce_is_small_and_known() -> None:
    """Three further points hold all light of this scene but (r / 2)^4 of it, at r = 0.6 below 1 %."""
    sky, _ = smooth_sky()
    scene = SurfaceScene(bowl_and_ball(), TINY, gloss=True)
    scene.set_environment(sky)
    cut, whole = (path_trace(scene, 1024, seed, depth) for seed, depth in ((1, 5), (2, -1)))
    covered = cut.mean.min(axis=-1) > 0
    missing = 1 - cut.mean[covered].mean() / whole.mean[covered].mean()
    assert -2e-3 < missing < 1e-2


def test_light_and_viewer_can_change_places() -> None:
    """Helmholtz: what a far camera sees in all of a lamp's light is what it would see from the lamp.

    Sums of images over all pixels, for a lamp of irradiance 1: shadows, gloss and all bounces included.
    """
    far = CameraSpec(size=24, distance=400.0)
    mesh = replace(bowl_and_ball(), vertices=0.9 * bowl_and_ball().vertices)
    axis = np.array([0.0, 0.0, 1.0])
    for lamp in DIRECTIONS[:2]:
        turn = rotation_between(lamp, axis)
        there = total(SurfaceScene(mesh, far, gloss=True), lamp)
        back = total(SurfaceScene(turned(mesh, turn), far, gloss=True), turn @ axis)
        # Noise of 0.2 %; smooth normals on facets of 3 degrees are not quite reciprocal: 0.4 % seen
        np.testing.assert_allclose(there, back, rtol=1e-2)
        assert there.min() > 1.0


def total(scene: SurfaceScene, lamp: Array) -> Array:
    runs = [
        render_aovs(scene, 64, seed, replace(FULL, bounces=5), lamp[None]).directional[0] for seed in range(4)
    ]
    return np.asarray(np.mean(runs, axis=0).sum(axis=(0, 1)), dtype=np.float64)


def rotation_between(one: Array, other: Array) -> Array:
    """A rotation that takes a unit vector to another."""
    cross, cosine = np.cross(one, other), float(one @ other)
    skew = np.array([[0, -cross[2], cross[1]], [cross[2], 0, -cross[0]], [-cross[1], cross[0], 0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1 + cosine))


def test_the_mirrored_scene_answers_to_the_mirrored_light() -> None:
    mirror = np.diag([-1.0, 1.0, 1.0])
    here = averaged(scene_of(True), 12, DIRECTIONS)
    mirrored = SurfaceScene(turned(bowl_and_ball(), mirror), TINY, gloss=True)
    there = averaged(mirrored, 12, DIRECTIONS @ mirror)
    same = agreement(
        [flipped(maps.transport) for maps in here],
        [maps.transport for maps in there],
        here[0].coverage[:, ::-1],
    )
    assert same < 6  # 12 runs: Student's t of 22 degrees of freedom; 60,000 values reach about 6
    one, other = [m.directional[:, :, ::-1] for m in here], [maps.directional for maps in there]
    assert agreement(one, other, here[0].coverage[:, ::-1]) < 6
    unflipped = [maps.transport for maps in here]
    assert agreement(unflipped, [maps.transport for maps in there], here[0].coverage) > 20


def flipped(transport: Image) -> Array:
    moved = torch.from_numpy(np.moveaxis(transport, -1, 1).astype(np.float64))
    return np.moveaxis(mirror_transport(moved).numpy(), 1, -1)


def test_turning_the_scene_turns_the_coefficients() -> None:
    """A quarter turn about the viewing axis turns the picture, and the light by the SH rotation matrix."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    here = averaged(scene_of(True), 12)
    there = averaged(SurfaceScene(turned(bowl_and_ball(), quarter), TINY, gloss=True), 12)
    back = rotation_matrix(quarter, 4)
    turned_back = [
        np.rot90(np.einsum("kj,khwc->jhwc", back, maps.transport), -1, axes=(1, 2)) for maps in there
    ]
    assert agreement([maps.transport for maps in here], turned_back, here[0].coverage) < 6
    glossy = [np.rot90(np.einsum("kj,khw->jhw", back[:9, :9], m.gloss), -1, axes=(1, 2)) for m in there]
    assert agreement([maps.gloss for maps in here], glossy, here[0].coverage) < 6
    unturned = [np.rot90(maps.transport, -1, axes=(1, 2)) for maps in there]
    assert agreement([maps.transport for maps in here], unturned, here[0].coverage) > 20


def agreement(one: Sequence[Image], other: Sequence[Image], coverage: Image) -> float:
    """Largest z-score between two sets of images, where the surface fills the pixel."""
    (a, va), (b, vb) = mean_and_variance(one), mean_and_variance(other)
    difference = np.maximum(np.abs(a - b) - 2e-4, 0.0)  # pixels of facets that lie otherwise
    score = difference / np.sqrt(va + vb + 1e-10)
    return float(score[:, coverage == 1].max())
