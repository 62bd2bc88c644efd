from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.lights.area_lights import Panel, studio_environment
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import Light, direction_from_angles, rotation_about
from sfsnet_dr.sh.basis import sh_basis

GREY = np.array([0.5, 0.5, 0.5])
SUN = (direction_from_angles(40.0, 30.0), np.array([3.0, 2.5, 2.0]))


def composed() -> Light:
    """A soft panel and two lamps: one of everything."""
    panel = Panel(
        direction_from_angles(-50, 20), (25.0, 15.0), 10.0, 6.0, np.array([4.0, 5.0, 6.0]), round=False
    )
    walls = studio_environment((panel,), np.array([0.2, 0.15, 0.1]), np.array([0.05, 0.05, 0.05]))
    return Light("composed", walls, (SUN, (direction_from_angles(-70.0, -10.0), np.array([0.3, 0.4, 1.0]))))


def normals(count: int = 200) -> np.ndarray:
    random = np.random.default_rng(3).normal(size=(count, 3))
    return np.asarray(random / np.linalg.norm(random, axis=1, keepdims=True))


def test_a_white_dome_shades_everything_white() -> None:
    dome = Light("dome", np.ones((*MAP_SIZE, 3)))
    label = dome.shading_label()
    np.testing.assert_allclose(label.evaluate(normals()), 1.0, atol=1e-12)
    np.testing.assert_allclose(dome.shading(normals()), 1.0, atol=1e-12)
    np.testing.assert_allclose(dome.face_shading(), 1.0, atol=1e-12)


def test_directional_light_is_lamberts_law_and_its_coefficients_are_the_basis() -> None:
    light = Light("sun", None, (SUN,))
    facing = np.maximum(normals() @ SUN[0], 0)[:, None] * SUN[1] / np.pi
    np.testing.assert_allclose(light.shading(normals()), facing, atol=1e-15)
    np.testing.assert_allclose(
        light.coefficients(4).values, np.outer(sh_basis(SUN[0], 4), SUN[1]), atol=1e-15
    )
    assert not light.environment_coefficients(4).values.any()


def test_coefficients_add_map_and_lamps() -> None:
    light = composed()
    apart = light.environment_coefficients(4)
    for lamp in light.directional:
        apart = apart + Light("lamp", None, (lamp,)).coefficients(4)
    np.testing.assert_allclose(light.coefficients(4).values, apart.values, atol=1e-14)
    assert light.shading_label().values.shape == (9, 3)


def test_exposure_and_white_balance() -> None:
    light = composed()
    assert light.exposed(0.6).face_shading() @ LUMINANCE == pytest.approx(0.6, rel=1e-12)
    grey = light.balanced(1.0).face_shading()
    np.testing.assert_allclose(grey, light.face_shading() @ LUMINANCE, rtol=1e-12)
    np.testing.assert_allclose(light.balanced(0.0).face_shading(), light.face_shading(), rtol=1e-12)
    half = light.balanced(0.5).face_shading()
    assert grey.std() < half.std() < light.face_shading().std()


def test_a_deep_tint_is_balanced_no_further_than_cameras_do() -> None:
    sodium = Light("sodium", np.ones((*MAP_SIZE, 3)) * np.array([1.0, 0.6, 0.001]))
    balanced = sodium.balanced(1.0).face_shading()
    assert balanced[2] < 0.02 * balanced[1]


def test_all_light_turns_together() -> None:
    light, turn = composed(), rotation_about(np.array([0.0, 0.8, 0.6]), 70.0)
    expected = light.shading(normals() @ turn)  # rotated normals under rotated light look the same
    # The turned map is blurred by one bilinear lookup: 3.4e-4 of a shading of about 1 seen, times 3.
    np.testing.assert_allclose(light.turned(turn).shading(normals()), expected, atol=1e-3)
    assert np.abs(light.turned(turn.T).shading(normals()) - expected).max() > 0.2


def test_softening_keeps_the_power_and_the_given_directions() -> None:
    light = composed()
    near = rotation_about(np.array([1.0, 0.0, 0.0]), 1.5) @ SUN[0]
    soft = light.softened(near[None])
    assert [lamp[0].tolist() for lamp in soft.directional] == [SUN[0].tolist()]
    # Power of a lobe on texels: 8e-5 seen, times 3.
    np.testing.assert_allclose(soft.coefficients(0).values, light.coefficients(0).values, rtol=2.5e-4)
    assert not light.softened(np.zeros((0, 3))).directional
    assert light.softened(np.stack([lamp[0] for lamp in light.directional])) is light


def test_a_softened_light_hardly_rings() -> None:
    sun = Light("sun", None, (SUN,))
    hard, soft = (
        light.coefficients(4).evaluate(normals(2000)) for light in (sun, sun.softened(np.zeros((0, 3))))
    )
    # Deepest negative light against the peak: 15 % and 4 % seen.
    assert hard.min() < -0.12 * hard.max()
    assert soft.min() > -0.06 * soft.max()


def test_headings_are_the_conventions_of_the_camera_frame() -> None:
    np.testing.assert_allclose(direction_from_angles(0, 0), [0, 0, 1], atol=1e-15)  # the viewer
    np.testing.assert_allclose(direction_from_angles(90, 0), [1, 0, 0], atol=1e-15)  # image right
    np.testing.assert_allclose(direction_from_angles(17, 90), [0, 1, 0], atol=1e-15)
    turned = rotation_about(np.array([0.0, 1.0, 0.0]), 90.0) @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(turned, [1, 0, 0], atol=1e-15)


@pytest.mark.parametrize(
    ("environment", "directional", "words"),
    [
        (None, (), "neither"),
        (np.ones((32, 64, 3)), (), "environment: shape"),
        (-np.ones((*MAP_SIZE, 3)), (), "negative"),
        (np.full((*MAP_SIZE, 3), np.nan), (), "NaN"),
        (None, ((np.array([0.0, 0.0, 2.0]), np.ones(3)),), "unit vector"),
        (None, ((np.array([0.0, 0.0, 1.0]), -np.ones(3)),), "irradiance"),
    ],
)
def test_what_is_no_light_is_refused(environment: object, directional: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        Light("x", environment, directional)  # type: ignore[arg-type]


def test_a_light_behind_everything_cannot_be_exposed() -> None:
    with pytest.raises(InputError, match="exposed"):
        Light("behind", None, ((np.array([0.0, 0.0, -1.0]), np.ones(3)),)).exposed(1.0)


def test_the_path_tracer_sees_the_same_light() -> None:
    """A convex ball, by Mitsuba: map and lamps together, direct light only."""
    from sfsnet_dr.render.path_tracer import path_trace
    from sfsnet_dr.scene.mesh import sphere_mesh
    from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
    from sfsnet_dr.scene.spec import CameraSpec

    light, radius = composed(), 0.9
    camera = CameraSpec(distance=1000.0, size=32)
    scene = SurfaceScene(sphere_mesh(radius), camera, light.directional, environment=True)
    assert light.environment is not None
    scene.set_environment(light.environment)
    images = [path_trace(scene, 1024, seed, depth=2).mean for seed in (0, 1)]

    fine = (np.arange(32 * 4) + 0.5) / (32 * 2) - 1  # 4 x 4 points a pixel, for its box filter
    x, y = np.meshgrid(fine / radius, -fine / radius)
    depth = np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))
    shading = 0.5 * light.shading(np.stack([x, y, depth], axis=-1))
    expected = shading.reshape(32, 4, 32, 4, 3).mean(axis=(1, 3))
    inside = (x**2 + y**2 < 0.9).reshape(32, 4, 32, 4).all(axis=(1, 3))

    def bias(prediction: np.ndarray) -> float:
        """Root mean square, of the mean; the noise of two independent images averages out."""
        first, second = ((image - prediction)[inside] for image in images)
        return float(np.sqrt(max((first * second).mean(), 0.0)) / expected[inside].mean())

    # Order 4 of the panel, 0.4 % seen; noise 0.029^2 / sqrt(1900 values) may add 0.5 % at 1 sigma.
    assert bias(expected) < 0.012
    assert bias(expected[:, ::-1]) > 0.15  # 0.23 seen for a mirrored light
