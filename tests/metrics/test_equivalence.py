"""Two noisy images: equal ones are refused at the stated rate, and what differs is seen at some scale."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy.special import polygamma

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.metrics.clusters import cluster_noise, inverse_trigamma, noise_clusters, shrink_variance
from sfsnet_dr.metrics.equivalence import (
    Agreement,
    Estimate,
    check_agreement,
    estimate_from_seeds,
    exact_estimate,
)

Array = npt.NDArray[np.float64]
SHAPE = (32, 32, 3)


def compared(seed: int, change: npt.ArrayLike = 0.0, mismatch: float = 0.5) -> Agreement:
    """Eight images against a reference; their noise differs from pixel to pixel, and in shape from its."""
    rng = np.random.default_rng(seed)
    deviation = 0.1 * np.exp(rng.normal(size=SHAPE))
    other = 0.2 * deviation * np.exp(mismatch * rng.normal(size=SHAPE))
    images = [1.0 + np.asarray(change) + deviation * rng.normal(size=SHAPE) for _ in range(8)]
    return check_agreement(
        estimate_from_seeds(images), Estimate(1.0 + other * rng.normal(size=SHAPE), other**2)
    )


@pytest.mark.parametrize("mismatch", [0.0, 0.5])
def test_equal_images_are_refused_at_most_as_often_as_stated(mismatch: float) -> None:
    p = np.array([compared(seed, mismatch=mismatch).p for seed in range(150)])
    # Binomial: with 15 expected below 0.1, 27 or more have a chance of 0.2 %; none at all one of 1e-7.
    assert 1 <= (p < 0.1).sum() < 27
    assert (p < 0.001).sum() <= 2


def test_each_scale_sees_what_is_made_for_it() -> None:
    spark = np.zeros(SHAPE)
    spark[5, 7, 1] = 5.0
    assert compared(0, spark).worst.name == "pixel"
    corner = np.zeros(SHAPE)
    corner[:8, 8:16, 0] = 0.08
    assert compared(1, corner).worst.name in ("block of 8", "cluster")
    everywhere = compared(2, 0.012)
    assert everywhere.worst.name == "picture"
    assert everywhere.p < 1e-6


def test_more_pairs_make_the_same_difference_less_telling() -> None:
    found = compared(0)
    assert found.p < found.p_among(10) < found.p_among(100) <= 1.0


def test_without_noise_an_allowance_decides() -> None:
    image = np.full(SHAPE, 0.5)
    assert check_agreement(exact_estimate(image), exact_estimate(image)).p == 1.0
    assert check_agreement(exact_estimate(image + 1e-4), exact_estimate(image), allowance=1.1e-4).p == 1.0
    assert check_agreement(exact_estimate(image + 1e-4), exact_estimate(image), allowance=0.9e-4).p < 1e-100


def test_a_few_images_do_not_pass_for_certain() -> None:
    """Pixels that 8 images never met, at an edge that the reference knows: their spread is 0 by luck."""
    reference = np.full(SHAPE, 1e-3)
    agreement = check_agreement(
        Estimate(np.zeros(SHAPE), np.zeros(SHAPE), 7.0), Estimate(reference, reference**2)
    )
    pixel = next(scale for scale in agreement.scales if scale.name == "pixel")
    assert pixel.p == 1.0


def test_clusters_of_noise_follow_the_fitted_distribution() -> None:
    mask = np.ones(SHAPE[:2], dtype=bool)
    sizes, fitted = noise_clusters(mask, 3000, seed=9), cluster_noise(mask)
    for quantile in (0.9, 0.99):
        size = int(np.quantile(sizes, quantile, method="higher"))
        seen = (sizes >= size).mean()
        assert fitted.p(size) == pytest.approx(seen, rel=0.35)


def test_moderation_recovers_variances_that_follow_the_expected_ones() -> None:
    rng = np.random.default_rng(0)
    expected = np.exp(rng.normal(size=20000))
    truth = 3.0 * expected
    seen = truth * rng.chisquare(7, size=truth.shape) / 7
    blended, freedom = shrink_variance(seen, 7, expected)
    assert freedom > 200
    np.testing.assert_allclose(blended, truth, rtol=0.25)
    # Nothing in common with the expected ones: little is borrowed from them.
    assert shrink_variance(truth * np.exp(rng.normal(size=truth.shape)), 7, expected)[1] < 12


def test_inverse_trigamma() -> None:
    for x in (1e-4, 0.3, 2.0, 50.0, 1e7):
        assert inverse_trigamma(float(polygamma(1, x))) == pytest.approx(x, rel=1e-6)


def test_bad_input_is_named() -> None:
    with pytest.raises(InputError, match="images: 1 found, at least 2"):
        estimate_from_seeds([np.zeros(SHAPE)])
    with pytest.raises(InputError, match="mean: NaN or inf"):
        exact_estimate(np.full(SHAPE, np.nan))
    with pytest.raises(InputError, match="reference: shape"):
        check_agreement(exact_estimate(np.zeros(SHAPE)), exact_estimate(np.zeros((8, 8, 3))))
