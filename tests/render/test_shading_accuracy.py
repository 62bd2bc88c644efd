"""How good SH shading of a convex Lambertian object is: published figures from our basis and kernel.

Everything follows from one directional light of unit irradiance, for which max(mu, 0) is the truth, and from
the energy of each band. Sources: Ramamoorthi and Hanrahan 2001; Basri and Jacobs 2003.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from sfsnet_dr.render.shading_numpy import shading
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.coefficients import Radiance
from sfsnet_dr.sh.kernel import band_of, clamped_cosine

Array = npt.NDArray[np.float64]

#: Direction of the light, and one at right angles to it: oblique, so that every basis function takes part.
LIGHT = np.array([2.0, 3.0, 6.0]) / 7
ACROSS = np.array([3.0, -6.0, 2.0]) / 7

#: Order: RMS, mean absolute and largest error over the sphere; decimals as published.
ERRORS = {
    0: (0.3227, 0.2813, 0.750),
    1: (0.1443, 0.1250, 0.250),
    2: (0.03608, 0.03067, 0.09375),
    4: (0.01804, 0.01483, 0.0586),
    6: (0.01128, 0.00895, 0.0427),
    8: (0.00789, 0.00606, 0.0336),
}
#: Half a unit of the last decimal that ERRORS gives.
HALF_UNITS = dict.fromkeys((0, 1), (5e-5, 5e-5, 5e-4)) | dict.fromkeys((2, 4, 6, 8), (5e-6, 5e-6, 5e-5))
#: Order: angles in degrees between normal and light at which the largest error occurs.
LARGEST_AT = {0: {0}, 1: {0, 90, 180}, 2: {90}, 4: {90}, 6: {90}, 8: {90}}
#: Order: lowest value, half a unit of its last decimal, and its angle.
LOWEST = {
    1: (-0.250, 5e-4, 180.0),
    2: (-0.03958, 5e-6, 122.2),
    4: (-0.0312, 5e-5, 180.0),
    6: (-0.0155, 5e-5, 104.8),
    8: (-7 / 512, 1e-12, 180.0),  # -0.01367, which tables cut to -0.0136
}


def _approximation(angles: npt.ArrayLike, order: int, window: npt.ArrayLike | None = None) -> Array:
    """What f_render shows for max(mu, 0) at these angles (radians), bands optionally weighted."""
    angle = np.asarray(angles, dtype=np.float64).reshape(-1, 1)
    normal = (np.cos(angle) * LIGHT + np.sin(angle) * ACROSS).T[None, :, :, None]
    radiance = np.pi * sh_basis(LIGHT, order)[:, None] * np.ones(3)  # irradiance pi: shading is max(mu, 0)
    light = Radiance(radiance).to_shading()
    weights = np.ones(order + 1) if window is None else np.asarray(window)
    return shading(normal, (light.values * weights[band_of(order)][:, None]).T.reshape(1, -1))[0, 0, :, 0]


def _sphere(points: int = 400_000) -> tuple[Array, Array]:
    """Angles of the midpoints of rings of equal area, and the true shading there."""
    mu = (np.arange(points) + 0.5) / points * 2 - 1
    return np.arccos(mu), np.maximum(mu, 0)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values * values)))


@pytest.mark.parametrize("order", ERRORS)
def test_errors_over_the_sphere(order: int) -> None:
    angle, truth = _sphere()
    error = _approximation(angle, order) - truth
    fine = np.radians(np.linspace(0, 180, 18_001))
    largest = np.abs(_approximation(fine, order) - np.maximum(np.cos(fine), 0))
    found = (_rms(error), float(np.abs(error).mean()), float(largest.max()))
    for value, published, half_unit in zip(found, ERRORS[order], HALF_UNITS[order], strict=True):
        # The largest published last digit is rounded; quadrature adds less than 1e-8.
        assert value == pytest.approx(published, abs=half_unit + 1e-8)
    at = {round(float(np.degrees(a))) for a in fine[largest > largest.max() - 1e-9]}
    assert at == LARGEST_AT[order]


@pytest.mark.parametrize("order", LOWEST)
def test_lowest_value_and_its_angle(order: int) -> None:
    published, half_unit, where = LOWEST[order]
    fine = np.radians(np.linspace(0, 180, 18_001))
    values = _approximation(fine, order)
    assert values.min() == pytest.approx(published, abs=half_unit + 1e-9)
    assert np.degrees(fine[values.argmin()]) == pytest.approx(where, abs=0.05 + 0.01)


def test_order_two_in_closed_form() -> None:
    """1/4 + mu/2 + 5/32 (3 mu^2 - 1): its RMS error, peak, back, and where it is negative."""
    angle, truth = _sphere()
    mu = np.cos(angle)
    values = _approximation(angle, 2)
    np.testing.assert_allclose(values, 1 / 4 + mu / 2 + 5 / 32 * (3 * mu * mu - 1), rtol=0, atol=1e-14)
    # Exact: the mean of max(mu, 0)^2 is 1/6, of the approximation 1/16 + 1/12 + 5/256.
    assert _rms(values - truth) == pytest.approx(np.sqrt(1 / 6 - 1 / 16 - 1 / 12 - 5 / 256), abs=1e-9)
    np.testing.assert_allclose(_approximation([0, np.pi], 2), [1.0625, 0.0625], rtol=0, atol=1e-14)
    negative = np.degrees(angle[values < 0])
    # The roots are (-8 +- sqrt 19) / 15; tables cut 145.479 to 145.47.
    roots = np.degrees(np.arccos((-8 + np.array([1, -1]) * np.sqrt(19)) / 15))
    np.testing.assert_allclose([negative.min(), negative.max()], roots, rtol=0, atol=0.001)
    np.testing.assert_allclose(roots, [104.048, 145.479], rtol=0, atol=0.001)
    assert np.mean(values < 0) == pytest.approx(0.2906, abs=5e-5)


def test_clamping_helps_little() -> None:
    angle, truth = _sphere()
    clamped = np.maximum(_approximation(angle, 2), 0)
    assert _rms(clamped - truth) == pytest.approx(0.03255, abs=5e-6)
    assert np.abs(clamped - truth).max() == pytest.approx(0.09375, abs=1e-5)


@pytest.mark.parametrize(
    ("window", "rms", "lowest"),
    [
        ((1 + np.cos(np.pi * np.arange(3) / 3)) / 2, 0.132, -0.047),
        (np.sinc(np.arange(3) / 3), 0.103, -0.034),
    ],
    ids=["hann", "lanczos"],
)
def test_windows_hurt(window: Array, rms: float, lowest: float) -> None:
    angle, truth = _sphere()
    values = _approximation(angle, 2, window)
    assert _rms(values - truth) == pytest.approx(rms, abs=5e-4)
    assert values.min() == pytest.approx(lowest, abs=5e-4)


def test_no_weight_of_the_second_band_removes_negatives_and_keeps_the_light() -> None:
    """At 180 degrees bands 0 and 1 give -1/4; what lifts that above 0 pushes the ring at 110 degrees down."""
    angle, _ = _sphere(20_000)
    lowest = [_approximation(angle, 2, [1, 1, w]).min() for w in np.linspace(0, 3, 61)]
    assert max(lowest) < -0.03


def test_energy_of_the_kernel_by_band() -> None:
    factors = clamped_cosine(8)
    fractions = np.array([1, 2 / 3, 1 / 4, 0, -1 / 24, 0, 1 / 64, 0, -1 / 128])
    np.testing.assert_allclose(factors, np.pi * fractions, rtol=0, atol=1e-15)
    bands = np.arange(9)
    share = (
        100 * factors**2 * (2 * bands + 1) / (4 * np.pi) / (2 * np.pi / 3)
    )  # of the integral of max(mu, 0)^2
    np.testing.assert_allclose(share[[0, 1, 2]], [37.5, 50, 11.71875], rtol=1e-13)
    np.testing.assert_allclose(share[[4, 6, 8]], [0.586, 0.119, 0.039], rtol=0, atol=5e-4)
    assert share[:3].sum() == pytest.approx(99.219, abs=5e-4)
    assert share[:5].sum() == pytest.approx(99.805, abs=5e-4)
