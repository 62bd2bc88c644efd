"""Transport with gloss, interreflection and directional lights against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.bowls import bowl_and_ball
from numpy.typing import NDArray

from sfsnet_dr.render.aovs import TransportOptions, render_aovs
from sfsnet_dr.scene.jit import mi, upload_array
from sfsnet_dr.scene.mesh import bowl_mesh, join_meshes, sphere_mesh
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene, camera_rays
from sfsnet_dr.scene.spec import CameraSpec

Array = NDArray[np.float64]

SMALL = CameraSpec(size=32)
FULL = TransportOptions(order=4, bounces=3, paths=4)
WHITE = np.sqrt(4 * np.pi)  # the coefficient of radiance 1 from everywhere


@pytest.mark.parametrize("bounces", [0, 1, 3])
def test_light_between_the_points_of_a_bowl_is_a_geometric_series(bounces: int) -> None:
    """In a white sky a half sphere of albedo r sees half sky and half itself from every point of it.

    The share of itself is its area over the sphere's (an integrating sphere), so that b further points give
    r / 2 times 1 + r / 2 + ... + (r / 2)^b.
    """
    colour = np.array([0.2, 0.5, 0.8])
    scene = SurfaceScene(bowl_mesh(tuple(colour)), SMALL)
    maps = render_aovs(scene, 64, 0, replace(FULL, bounces=bounces))
    inside = maps.coverage == 1
    inside &= np.hypot(*np.meshgrid(*[np.linspace(-1, 1, 32)] * 2)) < 0.8  # away from the facets of the rim
    seen = maps.transport[0][inside] * WHITE
    expected = colour / 2 * sum((colour / 2) ** k for k in range(bounces + 1))
    # 256 paths of 400 pixels: noise of 1e-3; facets lie 0.06 % inside the sphere
    np.testing.assert_allclose(seen.mean(axis=0), expected, rtol=5e-3)


def test_a_lamp_into_a_bowl_is_spread_evenly_by_its_first_bounce() -> None:
    """All points of the bowl get the same light from all others: 1 / (4 pi R^2) of what they reflect.

    Light of irradiance 1 along the axis brings pi R^2 into the bowl; r of it goes on, half of that to the
    bowl: irradiance r / 4 everywhere, and of the next bounce r / 2 of that.
    """
    albedo = 0.6
    lamp = np.array([[0.0, 0.0, 1.0]])
    with_bounces = render_aovs(
        SurfaceScene(bowl_mesh((albedo,) * 3), SMALL), 32, 0, replace(FULL, bounces=2), lamp
    )
    without = render_aovs(
        SurfaceScene(bowl_mesh((albedo,) * 3), SMALL), 32, 0, replace(FULL, bounces=0), lamp
    )
    inside = without.coverage == 1
    inside &= np.hypot(*np.meshgrid(*[np.linspace(-1, 1, 32)] * 2)) < 0.8
    depth = np.abs(without.normal[..., 2])[inside]
    np.testing.assert_allclose(without.directional[0][inside][:, 0], albedo / np.pi * depth, rtol=2e-2)
    spread = (with_bounces.directional[0] - without.directional[0])[inside]
    expected = albedo / np.pi * (albedo / 4) * (1 + albedo / 2)
    assert spread.mean() == pytest.approx(expected, rel=1e-2)
    left, right = spread[: len(spread) // 2].mean(), spread[len(spread) // 2 :].mean()
    assert left == pytest.approx(right, rel=2e-2)  # even


def test_gloss_in_a_white_sky_is_the_reflectance_of_the_lobes() -> None:
    """On a black ball nothing is left but G; its value for Y_0 is an integral of Mitsuba's BSDF."""
    for mix in (0.0, 1.0):
        ball = sphere_mesh(radius=0.8, albedo=(0.0, 0.0, 0.0))
        ball = replace(ball, roughness_mix=np.full(len(ball.vertices), mix))
        scene = SurfaceScene(ball, SMALL, gloss=True)
        maps = render_aovs(scene, 64, 0, FULL)
        for row in (16, 8, 4):
            cosine = float(maps.normal[row, 16] @ toward_viewer(row))
            expected = reflectance(scene, cosine)
            # 256 paths: 1 % of noise; the pixel holds angles of 4 degrees
            assert maps.gloss[0, row, 16] * WHITE == pytest.approx(expected, rel=4e-2), (mix, row)
        assert np.abs(maps.transport).max() == 0


def test_albedo_under_gloss_is_what_is_seen_straight_on_in_a_white_sky() -> None:
    for mix in (0.0, 0.4, 1.0):
        ball = sphere_mesh(radius=0.9, albedo=(0.1, 0.4, 0.7))
        ball = replace(ball, roughness_mix=np.full(len(ball.vertices), mix))
        maps = render_aovs(SurfaceScene(ball, SMALL, gloss=True), 16, 0, FULL)
        # Nothing shadows the ball, so that T has no noise; a pixel in the middle is seen from 2 degrees.
        np.testing.assert_allclose(maps.transport[0, 16, 16] * WHITE, (0.1, 0.4, 0.7), rtol=1e-3)
        np.testing.assert_allclose(maps.albedo[16, 16], (0.1, 0.4, 0.7), rtol=1e-5)
        assert 0.02 < maps.gloss[0, 16, 16] * WHITE < 0.05  # Fresnel's 2.8 % straight on, more at an angle


def toward_viewer(row: int) -> Array:
    """Unit vector from a pixel in the middle column toward the camera."""
    y = 1 - 2 * (row + 0.5) / SMALL.size
    back = np.array([-1.0 / SMALL.size, -y, SMALL.distance])
    return np.asarray(back / np.linalg.norm(back))


def reflectance(scene: SurfaceScene, cosine: float) -> float:
    """Reflected share of what falls on a glossy point, by quadrature over Mitsuba's BSDF."""
    z = (np.arange(800) + 0.5) / 800
    phi = (np.arange(400) + 0.5) / 400 * 2 * np.pi
    grid_z, grid_phi = (grid.ravel() for grid in np.meshgrid(z, phi))
    radius = np.sqrt(1 - grid_z**2)
    axes = (radius * np.cos(grid_phi), radius * np.sin(grid_phi), grid_z)
    toward = mi.Vector3f(*(upload_array(mi.Float, axis) for axis in axes))
    pixel = mi.UInt32(16 * 32 + 16)
    hit = scene.mi_scene.ray_intersect(camera_rays(scene.camera, pixel, mi.Point2f(0.5)))
    hit.wi = mi.Vector3f(float(np.sqrt(1 - cosine**2)), 0.0, float(cosine))
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.Glossy
    values = np.asarray(scene.bsdf.eval(context, hit, toward), dtype=np.float64)[0]
    return float(values.mean() * 2 * np.pi)


@pytest.mark.parametrize("gloss", [False, True])
def test_no_pixel_reflects_more_than_it_gets(gloss: bool) -> None:
    white = bowl_and_ball()
    white = replace(white, albedo=np.full_like(white.albedo, 0.9 if gloss else 1.0))
    maps = render_aovs(SurfaceScene(white, SMALL, gloss=gloss), 16, 0, replace(FULL, bounces=8))
    total = maps.transport[0] * WHITE
    if gloss:
        total = total + maps.gloss[0, ..., None] * WHITE
    # White in a white sky is white, but for 0.9^n after n points under gloss, and for what the interface's
    # model loses. 64 paths have noise of 2 % in the mean over 4 x 4 pixels.
    blocks = total.reshape(8, 4, 8, 4, 3).mean(axis=(1, 3))
    assert blocks.max() < 1.0 + 0.02
    inside = maps.coverage == 1
    assert (0.6 if gloss else 0.95) < total[inside].mean() < 1.0 + 2e-3


def test_light_that_a_ball_keeps_off_a_ball_is_not_there() -> None:
    """One ball in front of another along the lamp's direction: its shadow is as wide as itself."""
    lamp = np.array([[0.6, 0.0, 0.8]])
    near = sphere_mesh(radius=0.2, rings=48)
    near = replace(near, vertices=near.vertices + 0.75 * lamp[0])
    scene = SurfaceScene(join_meshes(sphere_mesh(radius=0.4, rings=48), near), SMALL)
    maps = render_aovs(scene, 16, 0, replace(FULL, bounces=0), lamp)
    ball = (maps.coverage == 1) & (np.abs(maps.albedo[..., 0] - 0.5) < 1e-3)
    point = maps.normal * 0.4  # of the ball at the origin
    off_axis = np.linalg.norm(point - (point @ lamp[0])[..., None] * lamp[0], axis=-1)
    lit_side = maps.normal @ lamp[0] > 0.1
    on_big = ball & (np.abs(maps.normal[..., :2] * 0.4 * SMALL.size / 2 - pixel_offset()).max(axis=-1) < 1.5)
    assert np.abs(maps.directional[0][on_big & lit_side & (off_axis < 0.16)]).max() == 0
    seen = maps.directional[0][on_big & lit_side & (off_axis > 0.27)][:, 0]
    expected = 0.5 / np.pi * (maps.normal @ lamp[0])[on_big & lit_side & (off_axis > 0.27)]
    np.testing.assert_allclose(seen, expected, rtol=0.03, atol=2e-3)


def pixel_offset() -> Array:
    """(H, W, 2) position of pixel centres from the image's centre, x right and y up, in pixels."""
    centre = np.arange(SMALL.size) + 0.5 - SMALL.size / 2
    return np.asarray(np.stack(np.meshgrid(centre, -centre), axis=-1))
