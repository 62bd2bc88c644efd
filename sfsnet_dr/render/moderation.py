"""Variances that were seen a few times only, made steadier by what is known of them from elsewhere.

A variance from 8 images has 7 degrees of freedom: a pixel would have to be off by 50 standard deviations
before chance can be excluded among a million, and an edge that 8 images missed shows no variance at all.
Method: Smyth, "Linear models and empirical Bayes methods", Stat. Appl. Genet. Mol. Biol. 2004. How far the
variances follow the expected ones is itself estimated, so that a wrong expectation weakens the test and
does not make it wrong.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Degrees of freedom above which a variance counts as known.
KNOWN: Final = 1e6


def moderated(variance: Array, freedom: float, expected: Array) -> tuple[Array, float]:
    """Blend variances with expected ones, as far as these are seen to hold.

    Args:
        variance: estimates, any shape; 0 where no spread was seen.
        freedom: degrees of freedom of each.
        expected: the same shape, up to a common factor; 0 where nothing is known.

    Returns:
        The blended variances and their degrees of freedom. Both as they came where ``freedom`` is large, or
        too few values are above 0 to judge by.
    """
    from scipy.special import digamma, polygamma

    seen = (variance > 0) & (expected > 0)
    if freedom >= KNOWN or seen.sum() < 2:
        return variance, freedom
    ratio = np.log(variance[seen] / expected[seen])
    spread = float(ratio.var(ddof=1)) - float(polygamma(1, freedom / 2))
    if spread <= 0:
        factor = np.exp(ratio.mean() - digamma(freedom / 2) + np.log(freedom / 2))
        return np.where(expected > 0, factor * expected, variance), KNOWN
    prior = min(2.0 * inverse_trigamma(spread), KNOWN)
    centre = (
        ratio.mean() - digamma(freedom / 2) + np.log(freedom / 2) + digamma(prior / 2) - np.log(prior / 2)
    )
    blended = (prior * np.exp(centre) * expected + freedom * variance) / (prior + freedom)
    # Where nothing is expected, the estimate itself stands in for the expectation.
    return np.where(expected > 0, blended, variance), prior + freedom


def inverse_trigamma(value: float) -> float:
    """The x > 0 whose trigamma is ``value`` > 0, by Newton's method on its reciprocal (Smyth's appendix)."""
    from scipy.special import polygamma

    if value > 1e7:
        return float(1 / np.sqrt(value))
    if value < 1e-6:
        return 1 / value
    x = 0.5 + 1 / value
    for _ in range(50):
        trigamma = float(polygamma(1, x))
        step = trigamma * (1 - trigamma / value) / float(polygamma(2, x))
        x += step
        if abs(step) < 1e-10 * x:
            break
    return x
