from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sfsnet_dr.core import runtime
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.lights.vmf_lobes import Lobe
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.projection import (
    equirect_directions,
    equirect_solid_angles,
    project_directional,
    project_equirect,
)

ORDER = 8


def mitsuba_radiance(image: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """What Mitsuba's ``envmap`` sends from the directions (N, 3)."""
    runtime.start()
    import drjit as dr
    import mitsuba as mi

    bitmap = mi.Bitmap(image.astype(np.float32))
    emitter = mi.load_dict({"type": "envmap", "bitmap": bitmap})
    surface = dr.zeros(mi.SurfaceInteraction3f, len(directions))
    surface.wi = -mi.Vector3f(np.ascontiguousarray(directions.T, dtype=np.float32))
    return np.array(emitter.eval(surface), dtype=np.float64).T


def cell_quadrature(
    height: int, width: int, nodes: int = 10
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Directions (N, 3) and weights over the cells between texel centres, where the radiance is smooth."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    x, w = (x + 1) / 2, w / 2
    theta = np.pi * (np.arange(height - 1)[:, None] + x).ravel() / (height - 1)
    phi = 2 * np.pi * (np.arange(width)[:, None] + 0.5 + x).ravel() / width
    theta_weight = np.tile(w, height - 1) * np.pi / (height - 1) * np.sin(theta)
    phi_weight = np.tile(w, width) * 2 * np.pi / width
    t, p = np.meshgrid(theta, phi, indexing="ij")
    directions = np.stack([np.sin(t) * np.sin(p), np.cos(t), -np.sin(t) * np.cos(p)], axis=-1)
    return directions.reshape(-1, 3), np.outer(theta_weight, phi_weight).ravel()


@pytest.mark.parametrize(("height", "width"), [(3, 3), (5, 8), (6, 7)])
def test_integrates_what_mitsuba_evaluates(height: int, width: int) -> None:
    image = np.random.default_rng(height).random((height, width, 3))
    directions, weights = cell_quadrature(height, width)
    radiance = mitsuba_radiance(image, directions)
    expected = (sh_basis(directions, ORDER) * weights[:, None]).T @ radiance
    # Mitsuba evaluates in float32: errors of 1e-6 in radiance seen, which weigh at most as their mean.
    np.testing.assert_allclose(project_equirect(image, ORDER).values, expected, atol=2e-6)


def test_texel_centres_are_mitsubas() -> None:
    """At a centre, interpolation gives the texel itself; not at the poles, where all columns meet."""
    image = np.random.default_rng(0).random((6, 9, 3))
    centres = equirect_directions(6, 9)[1:-1].reshape(-1, 3)
    # A float32 direction moves the sample by up to 1e-6 of the image, 1e-5 of a texel.
    np.testing.assert_allclose(mitsuba_radiance(image, centres), image[1:-1].reshape(-1, 3), atol=2e-5)


def test_named_directions() -> None:
    """Middle column +z; to its right, a quarter turn on, -x; first row +y."""
    directions = equirect_directions(5, 8)
    np.testing.assert_allclose(
        (directions[2, 3] + directions[2, 4]) / 2 / np.cos(np.pi / 8), [0, 0, 1], atol=1e-15
    )
    np.testing.assert_allclose(
        (directions[2, 5] + directions[2, 6]) / 2 / np.cos(np.pi / 8), [-1, 0, 0], atol=1e-15
    )
    np.testing.assert_allclose(directions[0], np.tile([0.0, 1, 0], (8, 1)), atol=1e-15)


def test_uniform_map_is_the_constant_alone() -> None:
    values = project_equirect(np.full((4, 6, 3), 2.5), ORDER).values
    np.testing.assert_allclose(values[0], 2.5 * np.sqrt(4 * np.pi), rtol=1e-13)
    np.testing.assert_allclose(values[1:], 0, atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_light_from_an_axis_has_its_linear_term(axis: int, sign: int) -> None:
    """Brightness that grows toward an axis has its first moment in that axis's coefficient."""
    image = np.clip(sign * equirect_directions(33, 64)[..., axis], 0, None)[..., None] * np.ones(3)
    linear = project_equirect(image, 1).values[1:, 0]
    assert np.argmax(sign * linear) == [1, 2, 0][axis]
    # The clamped cosine's own moment, 2 pi/3 sqrt(3/(4 pi)); interpolation over 33 rows costs up to 0.1 %.
    assert np.abs(linear).max() == pytest.approx(2 * np.pi / 3 * np.sqrt(3 / (4 * np.pi)), rel=2e-3)
    assert np.sort(np.abs(linear))[1] < 1e-12


def test_error_falls_with_the_square_of_the_resolution() -> None:
    """Bilinear interpolation is of second order: half the step, a quarter of the error."""
    lobe = Lobe(np.array([0.48, 0.6, 0.64]), 6.0, np.ones(3))
    errors = []
    for height in (33, 65, 129):
        image = lobe.radiance(equirect_directions(height, 2 * (height - 1)))
        errors.append(np.abs(project_equirect(image, ORDER).values - lobe.coefficients(ORDER)).max())
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.1)


def test_solid_angles() -> None:
    """They cover the sphere, are equal along a row, and weigh a map as its constant coefficient does."""
    image = np.random.default_rng(2).random((5, 7, 3))
    angles = equirect_solid_angles(5, 7)
    assert angles.sum() == pytest.approx(4 * np.pi, rel=1e-14)
    mean = np.einsum("hw,hwc->c", angles, image) / np.sqrt(4 * np.pi)
    np.testing.assert_allclose(project_equirect(image, 0).values[0], mean, rtol=1e-13)


def test_directional_light_peaks_at_17_16ths() -> None:
    """max(mu, 0) is seen at order 2 as 1/4 + mu/2 + 5/32 (3 mu^2 - 1), times irradiance / pi."""
    irradiance = np.array([np.pi, 2 * np.pi, 0])
    toward = np.array([2.0, -1, 2])
    shading = project_directional(toward, irradiance, 2).to_shading()
    for mu, tangent in ((1.0, 0.0), (-1.0, 0.0), (0.6, 0.8)):
        normal = mu * toward / 3 + tangent * np.array([1, 2, 0]) / np.sqrt(5)
        expected = 1 / 4 + mu / 2 + 5 / 32 * (3 * mu**2 - 1)
        np.testing.assert_allclose(shading.evaluate(normal), expected * irradiance / np.pi, atol=1e-14)


def test_bad_input() -> None:
    with pytest.raises(InputError, match=r"environment map: shape \(4, 6\) found"):
        project_equirect(np.zeros((4, 6)), 2)
    with pytest.raises(InputError, match="2 x 6 found, at least 3 x 3"):
        project_equirect(np.zeros((2, 6, 3)), 2)
    with pytest.raises(InputError, match="NaN or inf"):
        project_equirect(np.full((4, 6, 3), np.nan), 2)
    with pytest.raises(InputError, match=r"direction: length 0.0"):
        project_directional([0, 0, 0], [1, 1, 1], 2)
    with pytest.raises(InputError, match=r"irradiance: shape \(1,\)"):
        project_directional([0, 0, 1], [1], 2)
