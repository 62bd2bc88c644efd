"""Photometric stereo against surfaces whose normals, albedo and lamps are known."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.estimation.light_intensities import LightImages, LightIntensities, estimate_light_intensities
from sfsnet_dr.estimation.photometric_stereo import photometric_stereo
from sfsnet_dr.metrics.normals import angles_deg

Array = npt.NDArray[np.float64]


def dome(size: int = 16, radius: float = 1.3) -> Array:
    """Normals (size, size, 3) of a sphere's front, up to about 50 degrees from the viewer."""
    centre = (np.arange(size) + 0.5) * 2 / size - 1
    x, y = np.meshgrid(centre / radius / 1.2, -centre / radius / 1.2)
    return np.stack([x, y, np.sqrt(1 - x * x - y * y)], -1)


def ring(count: int, seed: int = 0) -> Array:
    """Directions within 70 degrees of the viewer."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(np.cos(np.radians(70)), 1, count)
    phi = 2 * np.pi * (np.arange(count) + rng.uniform(0, 0.5, count)) / count
    s = np.sqrt(1 - z * z)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], -1)


def pictures(normal: Array, albedo: Array, lights: Array, gains: Array | float = 1.0) -> Array:
    shade = np.maximum(np.einsum("hwc,nc->nhw", normal, lights), 0)
    return np.asarray(shade[..., None] * albedo * np.broadcast_to(gains, len(lights))[:, None, None, None])


COLOUR = np.array([0.5, 0.4, 0.3])


@pytest.mark.parametrize("count", [4, 8, 64])
def test_a_lambertian_surface_comes_back_exactly(count: int) -> None:
    normal, lights = dome(), ring(count)
    lights = lights * [0.3, 0.3, 1]  # none leaves a pixel in shadow
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    found = photometric_stereo(pictures(normal, COLOUR, lights), lights * 3, np.ones(count))
    # Float64 sums; the ridge of 1e-6 against weights of about 4 moves normals by 1e-5 degrees.
    assert angles_deg(found.normal, normal).max() < 1e-3
    np.testing.assert_allclose(found.albedo, np.broadcast_to(COLOUR, found.albedo.shape), rtol=3e-5)
    assert found.residual.max() < 1e-4


def test_shadow_gloss_and_saturation_do_not_move_it_but_would_move_least_squares() -> None:
    rng = np.random.default_rng(1)
    normal, lights = dome(), ring(24)
    images = pictures(normal, COLOUR, lights)
    shadow = rng.uniform(size=images.shape[:3]) < 0.12
    gloss = (rng.uniform(size=images.shape[:3]) < 0.06) & ~shadow
    images[shadow] *= 0.1
    images[gloss] += 0.6
    images = np.minimum(images, 1)
    plain = np.linalg.lstsq(lights, images.mean(-1).reshape(24, -1), rcond=None)[0].T.reshape(16, 16, 3)
    found = photometric_stereo(images, lights, np.ones(24))
    assert angles_deg(plain, normal).mean() > 5  # 9.3 measured
    assert angles_deg(found.normal, normal).mean() < 0.5  # 0.2 measured; weights of outliers are small, not 0


def test_confidence_falls_where_most_lights_are_outliers() -> None:
    normal, lights = dome(), ring(16)
    images = pictures(normal, COLOUR, lights)
    rng = np.random.default_rng(2)
    images[:, :, :8] *= rng.uniform(0.2, 1.8, images[:, :, :8].shape[:3])[..., None]
    images[:, :4] = 0
    found = photometric_stereo(images, lights, np.ones(16))
    assert (found.confidence[:4] == 0).all()
    assert np.median(found.confidence[4:, :8]) < 0.5 < 0.99 < np.median(found.confidence[4:, 8:])
    assert np.median(found.residual[4:, :8]) > 10 * np.median(found.residual[4:, 8:])


def test_gains_are_taken_out() -> None:
    normal, lights = dome(), ring(12)
    gains = np.linspace(0.7, 1.4, 12)
    images = pictures(normal, COLOUR, lights, gains)
    half = np.tile([1.0] * 8 + [0.0] * 8, (16, 1))
    found = photometric_stereo(images, lights, gains, half)
    assert angles_deg(found.normal, normal)[:, :8].max() < 0.1
    assert (found.confidence[:, 8:] == 0).all()
    assert (found.normal[:, 8:] == [0, 0, 1]).all()
    assert angles_deg(photometric_stereo(images, lights, gains).normal, normal).max() < 0.1
    assert angles_deg(photometric_stereo(images, lights, np.ones(12)).normal, normal).mean() > 2


@pytest.mark.parametrize(
    ("images", "lights", "said"),
    [
        (np.zeros((3, 2, 2, 1)), np.eye(3), "lights: 3 found, at least 4"),
        (np.zeros((4, 2, 2, 1)), np.array([[1, 0, 1], [0, 0, 1], [-1, 0, 1], [2, 0, 1]]), "one plane"),
        (np.zeros((4, 2, 2, 1)), np.zeros((4, 3)), "zero, NaN or infinite"),
        (np.full((4, 2, 2, 1), np.nan), ring(4), "finite"),
        (np.zeros((4, 2, 2)), ring(4), "images: shape"),
    ],
)
def test_what_cannot_be_solved_is_refused(images: Array, lights: Array, said: str) -> None:
    with pytest.raises(InputError, match=said):
        photometric_stereo(images, lights, np.ones(len(images)))


def shots(lights: Array, gains: Array, albedo: float, size: int = 16) -> LightImages:
    values = pictures(dome(size), np.array([albedo]), lights, gains).reshape(len(lights), -1).T
    return LightImages(values, lights, tuple(f"l{j}" for j in range(len(lights))))


def test_strobes_and_the_oblique_gain_are_found_from_the_pictures() -> None:
    rng = np.random.default_rng(3)
    lights = ring(40, seed=4)
    strength = np.exp(rng.normal(0, 0.08, 40))
    strength /= np.exp(np.log(strength).mean())
    slope = np.polyfit(lights[:, 2], np.log(strength), 1)[0]
    strength *= np.exp(-slope * (lights[:, 2] - lights[:, 2].mean()))  # what cannot be told from k
    gains = strength * (1 + 0.3 * (1 - lights[:, 2]))
    found = estimate_light_intensities([shots(lights, gains, albedo, 24) for albedo in (0.3, 0.5)])
    assert found.oblique == pytest.approx(0.3, abs=0.1)
    got = np.array([found.strength[f"l{j}"] for j in range(40)])
    assert np.std(np.log(got / strength)) < 0.02  # 0.08 without the estimate
    assert found.spread < 0.01


def test_equal_lamps_on_a_lambertian_surface_are_found_equal() -> None:
    lights = ring(20)
    found = estimate_light_intensities([shots(lights, np.ones(20), 0.5)])
    assert found.oblique == pytest.approx(0, abs=0.01)
    np.testing.assert_allclose(list(found.strength.values()), 1, atol=0.01)


def test_a_shadow_on_a_part_of_the_face_is_hardly_taken_for_weak_lamps() -> None:
    """Equal lamps; those from above reach the lower half of the face by a fifth less, as under a brow."""
    lights, normal = ring(40, seed=5), dome(16)
    images = pictures(normal, np.array([0.5]), lights)
    images[np.ix_(lights[:, 1] > 0.3, normal[:, 0, 1] < 0)] *= 0.8
    names = tuple(f"l{j}" for j in range(40))
    found = estimate_light_intensities([LightImages(images.reshape(40, -1).T, lights, names)])
    assert np.std(np.log(list(found.strength.values()))) < 0.01  # 0.019 if nothing is shrunk
    errors = [
        angles_deg(photometric_stereo(images, lights, gains).normal, normal).mean()
        for gains in (np.ones(40), found.gains(names, lights))
    ]
    assert errors[1] < errors[0] + 0.5  # 0.3 measured, 0.9 if nothing is shrunk


def test_a_trend_with_the_angle_to_the_viewer_is_no_strobes() -> None:
    lights = ring(40, seed=4)
    found = estimate_light_intensities([shots(lights, 1 + 0.3 * (1 - lights[:, 2]), 0.4)])
    assert found.oblique == pytest.approx(0.3, abs=0.05)
    np.testing.assert_allclose(list(found.strength.values()), 1, atol=0.01)


def test_few_lights_leave_all_gains_at_one() -> None:
    assert estimate_light_intensities([shots(ring(8), np.linspace(1, 2, 8), 0.4)]) == LightIntensities()
