"""Confidence intervals by drawing the measured cases again."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError


class Interval(NamedTuple):
    """Ends of a confidence interval, in the unit of the statistic."""

    low: float
    high: float


def bootstrap_interval(
    values: npt.ArrayLike,
    statistic: Callable[[npt.NDArray[np.float64]], float] = lambda cases: float(np.mean(cases)),
    seed: int = 0,
    level: float = 0.95,
    draws: int = 2000,
) -> Interval:
    """Percentile bootstrap interval of a statistic over independent cases.

    Args:
        values: (N, ...), one entry a case. Pixels of one image are no independent cases; faces are.
        statistic: takes an array like ``values`` and returns a number. The mean if not given.
        seed: of the generator that draws the cases; the same seed gives the same interval.
        level: coverage, between 0 and 1. Below about 20 cases the true coverage is lower.
        draws: number of samples.

    Raises:
        InputError: for fewer than 2 cases, values that are not finite, or a level outside (0, 1).
    """
    cases = np.asarray(values, dtype=np.float64)
    if cases.ndim == 0 or cases.shape[0] < 2:
        raise InputError(f"values: shape {cases.shape} found, at least 2 cases expected")
    if not np.isfinite(cases).all():
        raise InputError("values: NaN or inf found, finite values expected")
    if not 0 < level < 1:
        raise InputError(f"level: {level} found, a number between 0 and 1 expected")
    generator = np.random.default_rng(seed)
    found = [statistic(cases[generator.integers(len(cases), size=len(cases))]) for _ in range(draws)]
    low, high = np.quantile(found, [(1 - level) / 2, (1 + level) / 2])
    return Interval(float(low), float(high))
