"""The quick form of the surface's scattering against Mitsuba's BSDF, which the references use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sfsnet_dr.render.bsdf_sampling import Scatter, prepare_scatter
from sfsnet_dr.scene.jit import dr, mi, upload_array
from sfsnet_dr.scene.mesh import sphere_mesh
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene, camera_rays
from sfsnet_dr.scene.spec import CameraSpec
from sfsnet_dr.sh.basis import sh_basis

Array = NDArray[np.float64]

COUNT = 40_000


def points(gloss: bool, seed: int = 0) -> tuple[SurfaceScene, mi.SurfaceInteraction3f, mi.Bool]:
    """A ball of uneven roughness, and points of it all over the image; some rays miss it."""
    ball = sphere_mesh(albedo=(0.6, 0.3, 0.1))
    mix = np.random.default_rng(0).uniform(size=len(ball.vertices))
    scene = SurfaceScene(replace(ball, roughness_mix=mix), CameraSpec(size=32), gloss=gloss)
    pixel = dr.arange(mi.UInt32, COUNT) % (32 * 32)
    hit = scene.mi_scene.ray_intersect(camera_rays(scene.camera, pixel, square(seed)))
    prepare_scatter()
    return scene, hit, hit.is_valid()


def square(seed: int) -> mi.Point2f:
    """Random points of the unit square."""
    return mi.Point2f(
        *(upload_array(mi.Float, axis) for axis in np.random.default_rng(seed).uniform(size=(2, COUNT)))
    )


def line(seed: int) -> mi.Float:
    """Random numbers."""
    return square(seed).x


def mean_and_error(values: mi.Color3f, chosen: Array) -> tuple[Array, Array]:
    array = np.asarray(values, dtype=np.float64)[:, chosen]
    return array.mean(axis=1), array.std(axis=1) / np.sqrt(array.shape[1])


@pytest.mark.parametrize("gloss", [False, True])
def test_values_are_those_of_mitsubas_bsdf(gloss: bool) -> None:
    scene, hit, found = points(gloss)
    at = Scatter(scene, hit, found)
    toward = mi.warp.square_to_uniform_sphere(square(5))  # from below, too
    context = mi.BSDFContext()
    for kind, value in ((mi.BSDFFlags.Diffuse, at.diffuse), (mi.BSDFFlags.Glossy, at.gloss)):
        context.type_mask = kind
        expected = np.asarray(scene.bsdf.eval(context, hit, toward, found))
        result = np.asarray(mi.Color3f(value(toward)))
        # float32 rounding of the same formulae and table: 2.4e-7 seen of values up to 2.5
        np.testing.assert_allclose(result, expected, rtol=2e-5, atol=1e-6)
        assert expected.max() > (0.1 if gloss or kind == mi.BSDFFlags.Diffuse else -1)


@pytest.mark.parametrize("gloss", [False, True])
def test_samples_have_the_mean_of_mitsubas(gloss: bool) -> None:
    scene, hit, found = points(gloss)
    at, chosen = Scatter(scene, hit, found), np.asarray(found)
    _, expected = scene.bsdf.sample(mi.BSDFContext(), hit, line(1), square(2), found)
    mean, error = mean_and_error(expected, chosen)
    toward, weight = at.leave(line(3), square(4))
    ours, our_error = mean_and_error(weight, chosen)
    assert (np.abs(ours - mean) < 4.5 * np.hypot(error, our_error)).all()
    assert (error < 0.01).all()
    # A mean of direction, too: the weights must belong to where the samples go.
    sideways, side_error = mean_and_error(weight * toward.z, chosen)
    sample, expected = scene.bsdf.sample(mi.BSDFContext(), hit, line(5), square(6), found)
    other, other_error = mean_and_error(expected * sample.wo.z, chosen)
    assert (np.abs(sideways - other) < 4.5 * np.hypot(side_error, other_error)).all()


def test_gloss_samples_have_the_mean_of_the_values() -> None:
    """Integral of value over the hemisphere by uniform directions against the mean of the weights."""
    scene, hit, found = points(True)
    at, chosen = Scatter(scene, hit, found), np.asarray(found)
    uniform = mi.warp.square_to_uniform_hemisphere(square(7))
    expected, error = mean_and_error(mi.Color3f(at.gloss(uniform) * dr.two_pi), chosen)
    _, weight = at.leave_gloss(line(8), square(9))
    mean, our_error = mean_and_error(mi.Color3f(weight), chosen)
    assert (np.abs(mean - expected) < 4.5 * np.hypot(error, our_error)).all()
    assert (our_error < error / 3).all()  # what it is for
    _, weight = at.leave_gloss(1.0 - 0.5 * line(8), square(9))  # the dull lobe too often
    assert (
        np.abs(mean_and_error(mi.Color3f(weight), chosen)[0] - expected) > 4.5 * np.hypot(error, our_error)
    ).all()


@pytest.mark.parametrize("gloss", [False, True])
def test_the_response_without_shadows_is_the_mean_over_the_hemisphere(gloss: bool) -> None:
    """sum_l kernel_l Y_l(n) against a mean over cosine-distributed directions, for one point."""
    scene, hit, found = points(gloss)
    lane = int(np.flatnonzero(np.asarray(found))[777])
    one = dr.gather(mi.SurfaceInteraction3f, hit, dr.full(mi.UInt32, lane, COUNT))
    at = Scatter(scene, one, mi.Bool(True))
    toward, weight = at.leave_diffuse(square(11))
    directions = np.asarray(one.to_world(toward), dtype=np.float64).T
    terms = sh_basis(directions, 4)[:, :, None] * np.asarray(weight, dtype=np.float64).T[:, None]
    mean, error = terms.mean(axis=0), terms.std(axis=0) / np.sqrt(COUNT)
    normal = np.asarray(one.sh_frame.n, dtype=np.float64)[:, 0]
    bands = np.stack([np.asarray(band, dtype=np.float64)[:, 0] for band in at.unshadowed(4)])
    order = np.repeat(np.arange(5), 2 * np.arange(5) + 1)
    expected = bands[order] * sh_basis(normal, 4)[:, None]
    assert (np.abs(mean - expected) < 4.5 * error + 1e-6).all()
    assert not (np.abs(mean - 1.02 * expected) < 4.5 * error + 1e-6).all()  # two per cent are seen


def test_scattering_is_reciprocal() -> None:
    """f(a, b) = f(b, a), where values hold the cosine of the way out."""
    scene, hit, found = points(True)
    toward = mi.warp.square_to_uniform_hemisphere(square(5))
    at = Scatter(scene, hit, found)
    back = mi.SurfaceInteraction3f(hit)
    back.wi = mi.Vector3f(toward)
    other = Scatter(scene, back, found)
    sound = np.asarray(found & (toward.z > 0.05) & (hit.wi.z > 0.05))
    for one, two in ((at.diffuse(toward), other.diffuse(hit.wi)), (at.gloss(toward), other.gloss(hit.wi))):
        there = np.asarray(mi.Color3f(one) / toward.z)[:, sound]
        back_again = np.asarray(mi.Color3f(two) / hit.wi.z)[:, sound]
        np.testing.assert_allclose(there, back_again, rtol=1e-4, atol=1e-6)
