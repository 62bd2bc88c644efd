"""Maps and transport against closed forms, against Mitsuba's own integrators, and under moving meshes."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.surfaces import plane_with_shade
from helpers.ztest import z_test

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.render.aovs import TransportMaps, render_aovs
from sfsnet_dr.scene.faces.face import sample_face
from sfsnet_dr.scene.faces.pose import project_points
from sfsnet_dr.scene.jit import dr, mi
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.mesh import plane_mesh, sphere_mesh
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.spec import CameraSpec, HeadSpec, SceneSpec
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.coefficients import Radiance
from sfsnet_dr.sh.kernel import band_of, clamped_cosine
from sfsnet_dr.sh.projection import equirect_directions, project_equirect

SMALL = CameraSpec(size=32)


def analytic(normal: np.ndarray, albedo: float) -> np.ndarray:
    """(K, ...) transport of a convex body: albedo A_l / pi Y_k(n)."""
    return np.moveaxis(albedo * sh_basis(normal, 2) * (clamped_cosine(2) / np.pi)[band_of(2)], -1, 0)


def averaged(scene: SurfaceScene, samples: int, runs: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean transport over independent runs and the variance of that mean."""
    found = np.stack([render_aovs(scene, samples, seed).transport.astype(np.float64) for seed in range(runs)])
    return found.mean(axis=0), found.var(axis=0, ddof=1) / runs


@pytest.fixture(scope="module")
def ball() -> TransportMaps:
    return render_aovs(SurfaceScene(sphere_mesh(radius=0.8), SMALL), 64, 0)


def test_coverage_of_a_sphere_is_the_area_of_its_outline(ball: TransportMaps) -> None:
    # A sphere of radius r at distance D is seen as a disc of radius D tan(asin(r / D)) at z = 0.
    outline = np.pi * (12 * np.tan(np.arcsin(0.8 / 12)) * SMALL.size / 2) ** 2
    # Seen 4e-4 off; each of about 100 border pixels has a stratified error below 1 / 64.
    assert ball.coverage.sum() == pytest.approx(outline, rel=2e-3)


def test_normals_of_a_sphere_are_those_of_the_points_seen(ball: TransportMaps) -> None:
    size, distance, radius = SMALL.size, SMALL.distance, 0.8
    centre = (np.arange(size) + 0.5) * 2 / size - 1
    x, y = np.meshgrid(centre, -centre)
    direction = np.stack([x, y, np.full_like(x, -distance)], axis=-1)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    origin = np.array([0.0, 0.0, distance])
    along = direction @ origin
    root = along**2 - distance**2 + radius**2
    hit = origin + (-along - np.sqrt(np.maximum(root, 0)))[..., None] * direction
    inner = (ball.coverage == 1) & (np.hypot(x, y) < 0.6)
    angle = np.degrees(np.arccos(np.clip(np.einsum("hwc,hwc->hw", ball.normal, hit / radius), -1, 1)))
    # A pixel spans 6 degrees of the sphere; 64 points miss its centre a little: seen 0.40 degrees, times 1.5.
    assert angle[inner].max() < 0.6


def test_a_white_furnace_shades_a_plane_with_its_albedo_exactly() -> None:
    # Y_00 is constant and nothing blocks a ray, so that there is no noise: float32 sums of 64 values.
    furnace = render_aovs(SurfaceScene(plane_mesh(), SMALL), 64, 0).transport[0] * np.sqrt(4 * np.pi)
    np.testing.assert_allclose(furnace, 0.5, rtol=2e-6)


def test_a_white_furnace_shades_a_sphere_with_its_albedo_but_for_its_facets(ball: TransportMaps) -> None:
    furnace = ball.transport[0][ball.coverage == 1] * np.sqrt(4 * np.pi)
    assert furnace.max() <= 0.5 * (1 + 2e-6)  # no pixel reflects more than it gets
    # Facets of 1.9 degrees block directions that lie above the smooth normal's horizon by less than half of
    # that: a share of at most sin^2(0.95 degrees) = 2.7e-4.
    assert 1 - furnace.mean() / 0.5 < 2.7e-4


def test_transport_of_a_sphere_is_the_clamped_cosine_expansion() -> None:
    scene = SurfaceScene(sphere_mesh(radius=0.8), SMALL)
    mean, variance = averaged(scene, 64, 12)
    maps = render_aovs(scene, 256, 99)
    inside = (maps.coverage == 1) & (maps.normal[..., 2] > 0.5)
    truth = analytic(maps.normal.astype(np.float64), 0.5)
    # Y(mean normal) against the mean of Y(normal) over a pixel: below 1.2e-3 here, where noise is about 1e-3.
    difference = np.abs(mean[..., 0] - truth)[:, inside] - 1.2e-3
    score = difference / np.sqrt(variance[..., 0][:, inside] + 1e-12)
    # 12 runs: Student's t of 11 degrees of freedom; 3,500 values reach about 6.
    assert score.max() < 8


def test_transport_of_a_plane_is_one_number_for_each_function() -> None:
    mean, variance = averaged(SurfaceScene(plane_mesh(), SMALL), 64, 12)
    truth = analytic(np.array([0.0, 0.0, 1.0]), 0.5)
    overall = mean[..., 0].mean(axis=(1, 2))
    error = np.sqrt(variance[..., 0].mean(axis=(1, 2)) / SMALL.size**2)
    assert (np.abs(overall - truth) < 4.5 * error + 1e-7).all()


def test_a_shade_moves_with_the_mesh() -> None:
    """Updating a mesh through the wrong parameters leaves old triangles in the way of shadow rays."""
    scene = SurfaceScene(plane_with_shade(-0.4), SMALL)
    before = render_aovs(scene, 32, 0).transport[0, ..., 0]
    scene.set_mesh(plane_with_shade(0.4))
    moved = render_aovs(scene, 32, 0)
    fresh = render_aovs(SurfaceScene(plane_with_shade(0.4), SMALL), 32, 0)
    np.testing.assert_array_equal(moved.transport, fresh.transport)
    after = moved.transport[0, ..., 0]
    beside = np.s_[:6]  # rows above the shade, where the plane itself is seen: 8 % darker on its side
    assert before[beside, :10].mean() < 0.96 * before[beside, -10:].mean()
    assert after[beside, -10:].mean() < 0.96 * after[beside, :10].mean()


def test_relit_transport_is_mitsubas_direct_render_of_a_head() -> None:
    """A smooth positive light of exactly order 2, one albedo: only noise may separate the two."""
    spec = SceneSpec("head", "anny", albedo=(0.5, 0.4, 0.3), camera=SMALL, head=HeadSpec(subdivision=1))
    scene = SurfaceScene(sample_face(5, spec).mesh, spec.camera)
    coefficients = np.zeros((9, 3))
    coefficients[:4] = [[3.0, 2.5, 2.0], [0.5, 0.6, 0.7], [0.6, 0.2, 0.4], [0.4, 0.7, 0.2]]
    coefficients[5] = 0.3
    sky = sh_basis(equirect_directions(*MAP_SIZE), 2) @ coefficients
    assert sky.min() > 0
    scene.set_environment(sky)
    light = project_equirect(sky, 2)
    assert np.abs(light.values - coefficients).max() < 4e-3  # bilinear texels of 2.8 degrees
    runs = [relit(render_aovs(scene, 128, seed), light) for seed in range(24)]
    image, variance = np.mean(runs, axis=0), np.var(runs, axis=0, ddof=1) / len(runs)
    direct, noise = mitsuba_direct(scene, 64, 24)
    covered = render_aovs(scene, 64, 0).coverage == 1
    result = z_test(image, variance, direct, noise, mask=covered, allowance=1e-4)
    assert result.passed, result
    shaded = z_test(image * 1.01, variance, direct, noise, mask=covered, allowance=1e-4)
    assert not shaded.passed  # one per cent is seen


def relit(maps: TransportMaps, light: Radiance) -> np.ndarray:
    return np.asarray(np.einsum("khwc,kc->hwc", maps.transport.astype(np.float64), light.values))


def mitsuba_direct(scene: SurfaceScene, samples: int, runs: int) -> tuple[np.ndarray, np.ndarray]:
    """Mitsuba's own camera, film and integrator: nothing of ours but the scene."""
    integrator = mi.load_dict({"type": "direct", "hide_emitters": True})
    images = np.stack(
        [
            np.asarray(mi.render(scene.mi_scene, integrator=integrator, spp=samples, seed=k))[..., :3]
            for k in range(runs)
        ]
    ).astype(np.float64)
    return images.mean(axis=0), images.var(axis=0, ddof=1) / runs


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(ball: TransportMaps) -> None:
    scene = SurfaceScene(sphere_mesh(radius=0.8), SMALL)
    np.testing.assert_array_equal(render_aovs(scene, 64, 0).transport, ball.transport)
    assert np.abs(render_aovs(scene, 64, 1).transport - ball.transport).max() > 1e-3


def test_a_second_face_compiles_nothing() -> None:
    scene = SurfaceScene(sphere_mesh(radius=0.8), SMALL)
    render_aovs(scene, 16, 0)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        scene.set_mesh(sphere_mesh(radius=0.7))
        render_aovs(scene, 33, 7)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert kernels
    assert all(kernel["cache_hit"] for kernel in kernels)


def test_mask_counts_pixels_that_are_face_skin_alone() -> None:
    spec = SceneSpec("head", "anny", camera=CameraSpec(size=64), head=HeadSpec(subdivision=1))
    face = sample_face(1, spec)
    maps = render_aovs(SurfaceScene(face.mesh, spec.camera), 16, 0)
    assert set(np.unique(maps.mask)) == {0.0, 1.0}
    assert (maps.coverage[maps.mask == 1] == 1).all()
    assert 0.2 < maps.mask.mean() < 0.7
    for eye in ("eye_image_left", "eye_image_right"):
        column, row = (project_points(face.landmarks[eye], spec.camera) / 2).astype(int)
        assert maps.mask[row - 1 : row + 2, column - 2 : column + 3].min() == 0  # eyeballs are no skin


def test_a_bad_request_is_refused() -> None:
    scene = SurfaceScene(plane_mesh(), SMALL)
    with pytest.raises(InputError, match="samples: 0 "):
        render_aovs(scene, 0, 0)
    with pytest.raises(InputError, match="make a new SurfaceScene"):
        scene.set_mesh(sphere_mesh())
    with pytest.raises(InputError, match="environment: NaN, inf or negative"):
        scene.set_environment(-1.0)
