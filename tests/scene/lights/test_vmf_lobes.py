from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.lights.vmf_lobes import (
    FRONTAL_SHADING,
    SHARPNESS,
    Lobe,
    LobeLight,
    frontal_shading,
    sample_lights,
)
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.projection import project_equirect

LIGHTS = sample_lights(np.random.default_rng(11), 60)


def fine_sphere(rows: int = 100, columns: int = 200) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Directions and weights; the grid integrates a lobe of sharpness 40 to rounding."""
    z, weights = np.polynomial.legendre.leggauss(rows)
    phi = 2 * np.pi * np.arange(columns) / columns
    sine = np.sqrt(1 - z**2)[:, None]
    grid = np.stack(
        [sine * np.cos(phi), sine * np.sin(phi), np.broadcast_to(z[:, None], (rows, columns))], axis=-1
    )
    return grid.reshape(-1, 3), np.repeat(weights * 2 * np.pi / columns, columns)


def test_closed_form_is_the_projection_of_the_radiance() -> None:
    directions, weights = fine_sphere()
    basis = sh_basis(directions, 8) * weights[:, None]
    for light in LIGHTS[:20]:
        expected = basis.T @ light.radiance(directions)
        # Sums of 20,000 terms: 5e-14 seen, times 20.
        np.testing.assert_allclose(light.coefficients(8).values, expected, atol=1e-12)


def test_lobe_holds_its_power() -> None:
    directions, weights = fine_sphere()
    lobe = Lobe(np.array([0.0, 0.6, 0.8]), 15.0, np.array([1.0, 2, 0]))
    np.testing.assert_allclose(weights @ lobe.radiance(directions), [1, 2, 0], rtol=1e-12)
    brightest = directions[np.argmax(lobe.radiance(directions)[:, 0])]
    assert brightest @ lobe.direction > np.cos(np.radians(2))


def test_never_negative() -> None:
    directions, _ = fine_sphere(40, 80)
    assert min(light.radiance(directions).min() for light in LIGHTS) >= 0


def test_exposed_for_the_front() -> None:
    """The true irradiance integral, not the expansion that the sampler exposes by."""
    directions, weights = fine_sphere()
    cosine = np.clip(directions[:, 2], 0, None) * weights / np.pi
    shadings = np.array([cosine @ light.radiance(directions) @ LUMINANCE for light in LIGHTS])
    # Orders above 8 held 0.22 % of it in the worst of 150 lights; times 2.
    low, high = FRONTAL_SHADING
    assert shadings.min() > low * 0.995
    assert shadings.max() < high * 1.005
    assert shadings.std() > 0.05
    exact = np.array([frontal_shading(light) for light in LIGHTS])
    np.testing.assert_allclose(exact, shadings, rtol=5e-3)


def test_spread_of_what_is_drawn() -> None:
    lobes = [lobe for light in LIGHTS for lobe in light.lobes]
    assert {len(light.lobes) for light in LIGHTS} == {1, 2, 3}
    assert all(light.lobes[0].direction[2] > 0 for light in LIGHTS)
    low, high = SHARPNESS
    assert all(low <= lobe.kappa <= high for lobe in lobes)
    directions = np.array([lobe.direction for lobe in lobes])
    assert directions[:, 2].mean() > 0.3  # mostly in front
    assert directions[:, 1].mean() > 0  # rather above
    assert directions[:, 2].min() < -0.2  # some behind
    tints = np.array([lobe.power / (lobe.power @ LUMINANCE) for lobe in lobes])
    assert tints[:, 0].max() > 1.5  # some as warm as a lamp
    assert tints[:, 2].max() > 1.2  # some as blue as the sky


def test_gradient_is_brighter_above() -> None:
    light = LobeLight(np.ones(3), 0.5, ())
    np.testing.assert_allclose(light.radiance([[0, 1, 0], [0, -1, 0], [1, 0, 0]])[:, 0], [1.5, 0.5, 1])


def test_same_generator_same_lights() -> None:
    again = sample_lights(np.random.default_rng(11), 60)
    for first, second in zip(LIGHTS, again, strict=True):
        np.testing.assert_array_equal(first.coefficients(2).values, second.coefficients(2).values)


def test_map_of_a_light_projects_to_its_coefficients() -> None:
    light = LIGHTS[0]
    found = project_equirect(light.equirect(128, 256), 2).values
    np.testing.assert_allclose(
        found, light.coefficients(2).values, atol=2e-3
    )  # bilinear texels of 1.4 degrees


def test_scaled() -> None:
    light = LIGHTS[1]
    np.testing.assert_allclose(light.scaled(3).coefficients(2).values, 3 * light.coefficients(2).values)


def test_bad_input() -> None:
    lobe = Lobe(np.array([0.0, 0, 1]), 5.0, np.ones(3))
    with pytest.raises(InputError, match=r"gradient: 1\.5 found, -1 to 1"):
        LobeLight(np.ones(3), 1.5, ())
    with pytest.raises(InputError, match="negative or NaN"):
        LobeLight(np.array([1.0, -0.1, 1]), 0, (lobe,))
    with pytest.raises(InputError, match="kappa is not positive"):
        LobeLight(np.ones(3), 0, (Lobe(lobe.direction, 0.0, np.ones(3)),))
