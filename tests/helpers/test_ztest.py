"""The z-test of images: it accepts equal ones at its stated rate and sees what it is there to see."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from helpers.ztest import ZTest, z_test
from scipy.stats import norm

from sfsnet_dr.core.errors import InputError

Array = npt.NDArray[np.float64]
SHAPE = (48, 48, 3)
SIGMA = 0.02


def _run(difference: npt.ArrayLike, seed: int, **options: object) -> ZTest:
    """Two noisy renders whose expectations differ by ``difference``."""
    rng = np.random.default_rng(seed)
    reference = 0.5 + SIGMA * rng.standard_normal(SHAPE)
    image = 0.5 + np.asarray(difference) + SIGMA * rng.standard_normal(SHAPE)
    variance = np.full(SHAPE, SIGMA**2)
    return z_test(image, variance, reference, variance, simulations=200, **options)  # type: ignore[arg-type]


def test_equal_images_are_refused_about_as_often_as_stated() -> None:
    refused = sum(not _run(0, seed, level=0.1).passed for seed in range(60))
    # Expected about 6; binomial: more than 14 has a chance of 0.1 %. Ignoring the reference's own noise would
    # refuse nearly all.
    assert refused <= 14


def test_scores_and_limits_are_those_of_the_normal_distribution() -> None:
    result = z_test(
        np.full((1, 2, 1), 0.3), np.full((1, 2, 1), 9e-4), np.zeros((1, 2, 1)), np.full((1, 2, 1), 16e-4)
    )
    np.testing.assert_allclose(result.z, 0.3 / 0.05)
    assert result.smallest_p == pytest.approx(2 * norm.sf(6), rel=1e-12)
    assert result.p_limit == pytest.approx(
        1 - np.sqrt(1 - 0.005), rel=1e-12
    )  # Sidak, two values, half of 0.01
    assert result.failing == 2


def test_one_wrong_pixel_is_seen() -> None:
    difference = np.zeros(SHAPE)
    difference[20, 30, 1] = 8 * SIGMA * np.sqrt(2)
    result = _run(difference, seed=0)
    assert not result.passed
    assert result.failing == 1
    assert np.abs(result.z).argmax() == np.ravel_multi_index((20, 30, 1), SHAPE)


def test_a_weak_but_broad_difference_is_seen_by_its_cluster() -> None:
    """One standard deviation over a quarter of one colour: no pixel fails, the cluster does."""
    difference = np.zeros(SHAPE)
    difference[:24, :24, 2] = -SIGMA * np.sqrt(2)
    results = [_run(difference, seed) for seed in range(10)]
    assert not any(r.passed for r in results)
    assert all(r.largest_cluster > 2 * r.cluster_limit for r in results)
    assert sum(r.failing == 0 for r in results) >= 8


def test_allowance_forgives_a_known_difference_only() -> None:
    ramp = np.linspace(0.05, 0.15, SHAPE[1])[None, :, None]
    assert not _run(ramp, seed=1).passed
    assert _run(ramp, seed=1, allowance=0.15 + 0 * ramp).passed
    assert not _run(ramp, seed=1, allowance=0.05).passed


def test_mask_leaves_pixels_out() -> None:
    difference = np.zeros(SHAPE)
    difference[:8] = 1
    mask = np.ones(SHAPE[:2])
    mask[:8] = 0
    result = _run(difference, seed=2, mask=mask)
    assert result.passed
    assert not result.z[:8].any()


def test_without_noise_only_equality_passes() -> None:
    image, zero = np.full(SHAPE, 0.5), np.zeros(SHAPE)
    assert z_test(image, zero, image, 0.0, simulations=50).passed
    other = image.copy()
    other[3, 4, 0] += 1e-9
    result = z_test(other, zero, image, 0.0, simulations=50)
    assert not result.passed
    assert np.isinf(result.z[3, 4, 0])


def test_bad_input_is_named() -> None:
    image, zero = np.full(SHAPE, 0.5), np.zeros(SHAPE)
    with pytest.raises(InputError, match=r"variance: -1 found, 0 or more"):
        z_test(image, zero - 1, image, zero)
    with pytest.raises(InputError, match="reference: shape"):
        z_test(image, zero, image[:3], zero)
    with pytest.raises(InputError, match="mean: NaN or inf"):
        z_test(image * np.nan, zero, image, zero)
    with pytest.raises(InputError, match="mask: no pixel above 0"):
        z_test(image, zero, image, zero, mask=np.zeros(SHAPE[:2]))
