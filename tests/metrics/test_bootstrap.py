"""Bootstrap intervals against the normal theory of a mean."""

from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.metrics.bootstrap import bootstrap_interval


@pytest.mark.parametrize(("level", "width"), [(0.95, 1.95996), (0.68, 0.99446)])
def test_interval_of_a_mean_is_that_of_the_normal_distribution(level: float, width: float) -> None:
    values = np.random.default_rng(0).normal(5, 2, 400)
    low, high = bootstrap_interval(values, seed=1, level=level, draws=8000)
    half = width * values.std() / np.sqrt(len(values))
    # An end is a quantile of 8000 draws: at 95 % its spread is about 2 % of the half width; three of them.
    assert low == pytest.approx(values.mean() - half, abs=0.06 * half)
    assert high == pytest.approx(values.mean() + half, abs=0.06 * half)


def test_coverage() -> None:
    """100 experiments of 40 cases: the intervals of 95 % contain the truth about that often."""
    rng = np.random.default_rng(2)
    ends = [bootstrap_interval(rng.exponential(1, 40), seed=i, draws=400) for i in range(100)]
    covered = sum(low <= 1 <= high for low, high in ends)
    assert 85 <= covered <= 100  # the percentile interval of a skewed mean covers some 92 %


def test_statistic_sees_whole_cases() -> None:
    """A ratio of sums over paired columns, whose true value 2 every sample shows exactly."""
    base = np.random.default_rng(3).uniform(1, 2, 30)
    pairs = np.stack([2 * base, base], axis=1)
    low, high = bootstrap_interval(pairs, lambda p: float(p[:, 0].sum() / p[:, 1].sum()))
    assert (low, high) == pytest.approx((2, 2), rel=1e-12)


def test_same_seed_same_interval() -> None:
    values = np.random.default_rng(4).normal(size=50)
    assert bootstrap_interval(values, seed=1) == bootstrap_interval(values, seed=1)
    assert bootstrap_interval(values, seed=1) != bootstrap_interval(values, seed=2)


def test_bad_input_is_named() -> None:
    with pytest.raises(InputError, match=r"values: shape \(1,\)"):
        bootstrap_interval([1.0])
    with pytest.raises(InputError, match="values: NaN"):
        bootstrap_interval([1.0, np.nan])
    with pytest.raises(InputError, match="level: 95 found"):
        bootstrap_interval([1.0, 2.0], level=95)
