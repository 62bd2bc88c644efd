"""Pins of the conventions page: each sentence of ``core.conventions`` and DESIGN holds, by another way."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from scipy import integrate
from scipy.special import sph_harm_y

from sfsnet_dr.core import conventions
from sfsnet_dr.core.color import linear_to_srgb, srgb_to_linear
from sfsnet_dr.core.conventions import (
    CHIN_ROW,
    EYE_DISTANCE,
    EYE_IMAGE_LEFT,
    EYE_IMAGE_RIGHT,
    FACE_SIZE,
    LIGHT_ORDER,
    LIGHT_SIZE,
    NORMAL_EPSILON,
)
from sfsnet_dr.core.visualize import show_normals
from sfsnet_dr.data.alignment import to_canonical
from sfsnet_dr.render.aovs import render_aovs
from sfsnet_dr.render.path_tracer import path_trace
from sfsnet_dr.render.shading_numpy import f_render, shading, unit
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.mesh import SHAPES
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.spec import CameraSpec
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.coefficients import Radiance, Shading
from sfsnet_dr.sh.projection import equirect_directions, project_equirect

Array = npt.NDArray[np.float64]

CAMERA = CameraSpec(size=32)
WHITE = SHAPES["sphere"]((1.0, 1.0, 1.0))


def lit_from(direction: tuple[float, float, float]) -> Array:
    """(H, W) luminance of a white sphere under one lamp, path traced."""
    lamp = Light("lamp", None, ((np.array(direction), np.full(3, np.pi)),))
    scene = SurfaceScene(WHITE, CAMERA, lamp.directional)
    return np.asarray(path_trace(scene, 16, 0, 2).mean[..., 1])


def test_the_page_names_this_file() -> None:
    assert "tests/core/test_conventions.py" in (conventions.__doc__ or "")


@pytest.mark.parametrize(
    ("direction", "bright", "dark"),
    [
        ((1.0, 0.0, 0.0), np.s_[:, 16:], np.s_[:, :16]),  # x to the image's right
        ((0.0, 1.0, 0.0), np.s_[:16], np.s_[16:]),  # y up, and row 0 on top
    ],
)
def test_a_lamp_at_plus_x_lights_the_right_and_one_at_plus_y_the_top(
    direction: tuple[float, float, float], bright: tuple[slice, ...], dark: tuple[slice, ...]
) -> None:
    image = lit_from(direction)
    assert image[bright].sum() > 100 * image[dark].sum()


def test_a_lamp_at_plus_z_stands_at_the_viewer() -> None:
    image = lit_from((0.0, 0.0, 1.0))
    assert image[15:17, 15:17].min() > 0.97
    np.testing.assert_allclose(image.sum(1)[:16], image.sum(1)[:15:-1], rtol=0.1)
    assert lit_from((0.0, 0.0, -1.0)).max() == 0


def test_the_frame_is_right_handed() -> None:
    x, y, z = np.eye(3)
    np.testing.assert_array_equal(np.cross(x, y), z)


def test_rendered_normals_point_right_up_and_to_the_viewer() -> None:
    normal = render_aovs(SurfaceScene(WHITE, CAMERA), 16, 0).normal
    i, j = np.mgrid[:32, :32] + 0.5  # centres of pixels: x = j + 1/2, y = i + 1/2
    target = np.stack([j / 16 - 1, 1 - i / 16, np.zeros((32, 32))], -1)
    eye, radius = np.array([0, 0, CAMERA.distance]), np.linalg.norm(WHITE.vertices, axis=1).max()
    ray = unit(target - eye)
    along = -(ray @ eye)  # the sphere's middle lies at the origin
    root = along**2 - CAMERA.distance**2 + radius**2
    inside = root > 0.1 * radius**2
    hit = eye + (along - np.sqrt(np.where(inside, root, 0)))[..., None] * ray
    # Means over pixels of 1 / 16 and facets of the mesh; 0.012 measured.
    np.testing.assert_allclose(normal[inside], hit[inside] / radius, atol=0.03)


def test_normals_are_shown_red_to_the_right_green_up_and_blue_to_the_viewer() -> None:
    vectors = np.eye(3)[None]
    np.testing.assert_array_equal(
        show_normals(vectors)[0], [[255, 128, 128], [128, 255, 128], [128, 128, 255]]
    )


def test_rows_of_an_environment_go_down_from_plus_y() -> None:
    directions = equirect_directions(64, 128)
    assert directions[0, :, 1].min() > 0.99
    assert directions[-1, :, 1].max() < -0.99
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1)


def test_pixels_at_integer_coordinates_are_corners() -> None:
    ramp = np.repeat((np.arange(FACE_SIZE) + 0.5)[None, :, None], FACE_SIZE, 0).repeat(3, 2)
    same = to_canonical(ramp, (EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT))
    np.testing.assert_allclose(same, ramp, atol=1e-4)  # eyes at the frame's place: nothing moves


def test_eyes_and_chin_of_the_canonical_frame() -> None:
    assert (FACE_SIZE, EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT) == (128, (45.0, 48.0), (83.0, 48.0))
    assert (EYE_DISTANCE, CHIN_ROW) == (38.0, 118.0)
    assert EYE_IMAGE_LEFT[0] < FACE_SIZE / 2 < EYE_IMAGE_RIGHT[0]  # the viewer's left comes first


def test_a_pixel_moves_with_the_eyes() -> None:
    """One bright pixel half way between the eyes lands half way between the frame's eyes."""
    image = np.zeros((200, 300, 3))
    image[90, 150] = 1.0  # its centre: (150.5, 90.5)
    eyes = ((150.5 - 19, 90.5), (150.5 + 19, 90.5))
    row, column = divmod(int(to_canonical(image, eyes)[..., 0].argmax()), 128)
    assert row in (47, 48)
    assert column in (63, 64)


def test_srgb_is_the_standards_curve() -> None:
    """IEC 61966-2-1: 12.92 below, exponent 2.4 above, and they meet."""
    linear = np.array([0.0, 0.001, 0.0031308, 0.18, 0.5, 1.0])
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(linear_to_srgb(linear), curve, atol=1e-6)
    np.testing.assert_allclose(srgb_to_linear(curve), linear, atol=1e-6)


#: Degree, order and part of each of the first nine real functions, as SciPy has them (no Condon-Shortley
#: phase: positive constants). "e" is even in azimuth, "o" odd.
NINE = [
    (0, 0, "e"),
    (1, 0, "e"),
    (1, 1, "e"),
    (1, 1, "o"),
    (2, 0, "e"),
    (2, 1, "e"),
    (2, 1, "o"),
    (2, 2, "e"),
]
NINE.append((2, 2, "o"))


def test_the_basis_is_real_with_positive_constants_in_the_papers_order() -> None:
    rng = np.random.default_rng(0)
    n = rng.normal(size=(50, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    theta, phi = np.arccos(n[:, 2]), np.arctan2(n[:, 1], n[:, 0])
    ours = sh_basis(n, LIGHT_ORDER)
    for k, (degree, order, part) in enumerate(NINE):
        value = sph_harm_y(degree, order, theta, phi) * (-1) ** order * (math.sqrt(2) if order else 1)
        np.testing.assert_allclose(ours[:, k], value.real if part == "e" else value.imag, atol=1e-12)


def test_the_basis_in_words_of_x_y_and_z() -> None:
    x, y, z = unit(np.array([0.3, 0.5, 0.8]))
    c1, c2 = math.sqrt(3 / (4 * math.pi)), math.sqrt(15 / (4 * math.pi))
    expected = [
        math.sqrt(1 / (4 * math.pi)),
        *(c1 * z, c1 * x, c1 * y),
        math.sqrt(5 / (16 * math.pi)) * (3 * z * z - 1),
        *(c2 * x * z, c2 * y * z, c2 / 2 * (x * x - y * y), c2 * x * y),
    ]
    np.testing.assert_allclose(sh_basis(np.array([x, y, z]), 2), expected)


def test_shading_is_two_thirds_and_a_quarter_of_radiance() -> None:
    """A_l / pi, by the integral of the clamped cosine against Legendre polynomials (Ramamoorthi 2001)."""
    legendre = (lambda t: 1.0, lambda t: t, lambda t: (3 * t * t - 1) / 2)
    factors = [2 * integrate.quad(lambda t, p=p: t * p(t), 0, 1)[0] for p in legendre]
    np.testing.assert_allclose(factors, [1, 2 / 3, 1 / 4])
    radiance = Radiance(np.ones((9, 3)))
    bands = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2])
    np.testing.assert_allclose(radiance.to_shading().values[:, 0], np.array(factors)[bands])


def test_a_white_surface_in_an_even_environment_of_one_shows_one() -> None:
    light = project_equirect(np.ones((64, 128, 3)), LIGHT_ORDER).to_shading()
    normal = unit(np.random.default_rng(1).normal(size=(1, 4, 4, 3)))
    planes = np.moveaxis(normal, -1, 1)
    np.testing.assert_allclose(shading(planes, light.flat()[None]), 1.0, atol=1e-12)
    image = f_render(planes, np.full((1, 3, 4, 4), 0.25), light.flat()[None])
    np.testing.assert_allclose(image, 0.25, atol=1e-12)


def test_the_networks_light_is_nine_red_nine_green_nine_blue() -> None:
    assert LIGHT_SIZE == 3 * (LIGHT_ORDER + 1) ** 2 == 27
    values = np.arange(27.0).reshape(9, 3)
    np.testing.assert_array_equal(Shading(values).flat(), [*values[:, 0], *values[:, 1], *values[:, 2]])


def test_a_lamp_of_irradiance_pi_gives_a_facing_white_surface_the_radiance_one() -> None:
    assert lit_from((0.0, 0.0, 1.0)).max() == pytest.approx(
        1.0, abs=2e-3
    )  # the mean cosine of a pixel of 1 / 16: 0.9988


def test_short_normals_are_lengthened_down_to_the_epsilon() -> None:
    assert NORMAL_EPSILON == 1e-12
    np.testing.assert_allclose(np.linalg.norm(unit(np.array([1e-6, 0, 0]))), 1.0)
    assert np.linalg.norm(unit(np.array([1e-8, 0, 0]))) == pytest.approx(1e-2)
