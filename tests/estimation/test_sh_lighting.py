"""The light fit: exact on its own model, near on faces with noise, unmoved by gloss and shadow."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.estimation.sh_lighting import MEAN_SKIN, fit_light
from sfsnet_dr.scene.lights.vmf_lobes import sample_lights
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.coefficients import Shading

Array = npt.NDArray[np.float64]

SIZE = 48
SKIN: Array = np.array(MEAN_SKIN)


def ball() -> tuple[Array, Array]:
    """Normals of a ball's front (a face's range) and its mask."""
    row, column = np.indices((SIZE, SIZE)) + 0.5
    x, y = (column - SIZE / 2) / (SIZE / 2), (SIZE / 2 - row) / (SIZE / 2)
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    return np.stack([x, y, z], -1), (z > 0.3).astype(float)


def true_lights(count: int) -> list[Shading]:
    return [light.coefficients(2).to_shading() for light in sample_lights(np.random.default_rng(5), count)]


def shading_error(found: Shading, truth: Shading) -> float:
    """Relative RMS difference of the shading of visible normals."""
    normal, mask = ball()
    basis = sh_basis(normal[mask > 0], 2)
    return float(np.linalg.norm(basis @ (found.values - truth.values)) / np.linalg.norm(basis @ truth.values))


def linear_angle(found: Shading, truth: Shading) -> float:
    """Degrees between the linear parts, x, y and z of all colours together."""
    a, b = (light.values[1:4].sum(axis=1) for light in (found, truth))
    return float(np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))))


def test_without_a_ridge_the_light_is_exact() -> None:
    normal, mask = ball()
    albedo = np.random.default_rng(0).uniform(0.1, 0.6, (SIZE, SIZE, 3))
    for truth in true_lights(5):
        found = fit_light(normal, albedo * truth.evaluate(normal), mask, albedo, ridge=0.0)
        np.testing.assert_allclose(found.light.values, truth.values, atol=1e-9)
        assert found.residual < 1e-9


def test_with_the_ridge_it_is_near_and_points_right() -> None:
    normal, mask = ball()
    errors, angles = [], []
    for truth in true_lights(20):
        found = fit_light(normal, SKIN * truth.evaluate(normal), mask)
        errors.append(shading_error(found.light, truth))
        angles.append(linear_angle(found.light, truth))
    assert max(errors) < 0.02  # 0.006 seen
    assert np.mean(angles) < 9.0  # 7.3 seen
    assert max(angles) < 35.0  # 23 seen, under nearly ambient light


@pytest.mark.parametrize("kind", ["gloss", "shadow"])
def test_a_tenth_of_outliers_is_thrown_off(kind: str) -> None:
    """A patch of gloss or cast shadow, which moves least squares by several times as much."""
    normal, mask = ball()
    row, column = np.indices((SIZE, SIZE))
    patch = (row < SIZE / 2) & (column < SIZE * 0.62) & (mask > 0)
    patch &= np.cumsum(patch).reshape(SIZE, SIZE) <= 0.1 * mask.sum()
    assert patch.sum() == pytest.approx(0.1 * mask.sum(), abs=1)
    robust, plain = [], []
    rng = np.random.default_rng(1)
    for truth in true_lights(8):
        clean = SKIN * truth.evaluate(normal) * rng.normal(1.0, 0.03, (SIZE, SIZE, 1))
        spoilt = (
            clean + patch[..., None] * clean[mask > 0].max() * 1.5
            if kind == "gloss"
            else clean * (1 - 0.95 * patch[..., None])
        )
        robust.append(shading_error(fit_light(normal, spoilt, mask).light, truth))
        plain.append(shading_error(fit_light(normal, spoilt, mask, robust=False).light, truth))
    assert np.mean(robust) < 0.1
    assert np.mean(robust) < 0.6 * np.mean(plain)


def test_least_squares_are_least_squares() -> None:
    normal, mask = ball()
    image = np.random.default_rng(0).uniform(0.1, 0.6, (SIZE, SIZE, 3))
    found = fit_light(normal, image, mask, ridge=0.0, robust=False)
    basis = sh_basis(normal[mask > 0], 2)
    exact = np.linalg.lstsq(basis, image[mask > 0] / SKIN, rcond=None)[0]
    np.testing.assert_allclose(found.light.values, exact, atol=1e-9)


def test_weights_fall_where_the_face_is_hidden() -> None:
    normal, mask = ball()
    truth = true_lights(1)[0]
    image = SKIN * truth.evaluate(normal)
    image[10:14, 20:28] = 0.0
    found = fit_light(normal, image, mask)
    assert found.weights[10:14, 20:28].max() < 0.7
    assert found.weights[30:, 20:28][mask[30:, 20:28] > 0].min() > 0.9
    assert not found.weights[mask == 0].any()


def test_bad_input_is_named() -> None:
    normal, mask = ball()
    image = np.full((SIZE, SIZE, 3), 0.3)
    with pytest.raises(InputError, match="0 pixels found, 50"):
        fit_light(normal, image, 0 * mask)
    with pytest.raises(InputError, match="image: shape"):
        fit_light(normal, image[..., :1], mask)
    with pytest.raises(InputError, match="NaN, inf or an albedo of 0"):
        fit_light(normal, image * np.nan, mask)
    with pytest.raises(InputError, match="NaN, inf or an albedo of 0"):
        fit_light(normal, image, mask, 0 * image)
