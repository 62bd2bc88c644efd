"""The search for the worst light against closed forms and brute force."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from sfsnet_dr.experiments.worst_light.search import (
    relative_errors,
    squared_error_matrix,
    worst_non_negative,
    worst_signed,
)
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.icosphere import icosphere
from sfsnet_dr.sh.kernel import band_of, clamped_cosine

Array = NDArray[np.float64]


def ball(order: int) -> tuple[Array, Array]:
    """Forms of a ball seen from all sides: its answers to basis lights are orthogonal, and A_l / pi large."""
    truth = np.diag(((clamped_cosine(4) / np.pi) ** 2)[band_of(4)])
    error = truth.copy()
    error[: (order + 1) ** 2, : (order + 1) ** 2] = 0
    return error, truth


def random_forms(seed: int, size: int = 9) -> tuple[Array, Array]:
    """Images of 40 pixels that weaken from light to light, and a model that differs from them."""
    rng = np.random.default_rng(seed)
    images = rng.normal(size=(40, size)) * 0.5 ** np.arange(size)
    wrong = images @ np.diag(rng.uniform(0, 1, size)) + 0.02 * rng.normal(size=(40, size))
    return wrong.T @ wrong, images.T @ images


@pytest.mark.parametrize("dimmest", [0.01, 0.05, 0.2])
def test_a_ball_from_all_sides_in_closed_form(dimmest: float) -> None:
    """Order 2 misses band 4 alone, whose image is 1/24 as bright as that of band 0.

    If that counts as an image, all of it is missed, else the share that 1/24 is of the dimmest that counts.
    """
    found = worst_signed(*ball(2), dimmest)
    assert found.error == pytest.approx(min(1.0, 1 / 24 / dimmest), rel=1e-4)
    assert found.bound == pytest.approx(found.error, rel=1e-4)
    assert np.abs(found.light[:16]).max() < max(0.02, dimmest)


@pytest.mark.parametrize("dimmest", [0.003, 0.03, 0.3])
def test_no_light_is_worse_and_brute_force_comes_close(dimmest: float) -> None:
    for seed in range(2):
        error, truth = random_forms(seed)
        found = worst_signed(error, truth, dimmest)
        assert found.error == pytest.approx(found.bound, rel=1e-5)
        np.testing.assert_allclose(relative_errors(found.light, error, truth, dimmest), found.error)
        rng = np.random.default_rng(seed)
        lights = rng.normal(size=(20_000, 9)) * 4.0 ** rng.normal(size=(20_000, 9))
        ratios = relative_errors(lights, error, truth, dimmest)
        starts = lights[np.argsort(ratios)[-4:]]
        climbed = max(climb(start, error, truth, dimmest) for start in starts)
        assert max(ratios.max(), climbed) <= found.bound * (1 + 1e-6)
        # The quotient has a kink where an image becomes too dim, on which a local search stops early.
        assert climbed > 0.95 * found.bound


def climb(start: Array, error: Array, truth: Array, dimmest: float) -> float:
    def objective(light: Array) -> float:
        return -float(relative_errors(light, error, truth, dimmest))

    end = minimize(objective, start / np.linalg.norm(start), method="BFGS")
    again = minimize(objective, end.x, method="Nelder-Mead", options={"maxiter": 1000})
    return -float(min(end.fun, again.fun))


def test_without_dim_images_it_is_the_generalised_eigenvalue() -> None:
    rng = np.random.default_rng(5)
    images = rng.normal(size=(60, 25))
    wrong = images * rng.uniform(0, 1, 25)
    error, truth = wrong.T @ wrong, images.T @ images
    values = np.linalg.eigvals(np.linalg.solve(truth, error)).real
    assert worst_signed(error, truth, 1e-6).error == pytest.approx(np.sqrt(values.max()), rel=1e-6)


def test_squares_are_products_of_the_basis() -> None:
    directions = np.random.default_rng(0).normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    half = sh_basis(directions, 2)
    products = np.einsum("di,dj->dij", half, half)
    found = np.einsum("dk,kij->dij", sh_basis(directions, 4), squared_error_matrix(4))
    np.testing.assert_allclose(found, products, atol=1e-13)


def test_lights_without_negative_parts_have_none_and_are_less_bad() -> None:
    error, truth = ball(2)
    found = worst_non_negative(error, truth, 0.05)
    radiance = sh_basis(icosphere(4), 4) @ found.light
    assert radiance.min() > -1e-9 * radiance.max()
    assert found.error < worst_signed(error, truth, 0.05).bound
    # No square of an expansion of order 2 is worse, but for the last of the climb: 1.5e-4 seen, times 5.
    rng = np.random.default_rng(1)
    roots = rng.normal(size=(20_000, 9)) * 3.0 ** rng.normal(size=(20_000, 9))
    lights = np.einsum("kij,ni,nj->nk", squared_error_matrix(4), roots, roots, optimize=True)
    assert relative_errors(lights, error, truth, 0.05).max() <= found.error * 1.001
    # On a ball the worst may be taken about an axis: squares (a + b z + c z^2)^2 come close to it.
    zonal = rng.normal(size=(20_000, 3)) @ np.eye(9)[[0, 1, 4]]
    lights = np.einsum("kij,ni,nj->nk", squared_error_matrix(4), zonal, zonal, optimize=True)
    best = relative_errors(lights, error, truth, 0.05).max()
    assert 0.97 * found.error < best <= found.error * 1.001
