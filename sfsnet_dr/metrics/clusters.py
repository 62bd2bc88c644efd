"""Do differences cluster? Largest clusters of pixels, and variances shrunk toward a common one.

A variance from 8 images has 7 degrees of freedom: a pixel would have to be off by 50 standard deviations
before chance can be excluded among a million, and an edge that 8 images missed shows no variance at all.
Method: Smyth, "Linear models and empirical Bayes methods", Stat. Appl. Genet. Mol. Biol. 2004. How far the
variances follow the expected ones is itself estimated, so that a wrong expectation weakens the test and
does not make it wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

#: Two-sided p below which a pixel belongs to a cluster. Loose, because clusters are judged by their size: a
#: fifth of the pixels of noise exceed it with either sign, too few to join up, but more than half of those
#: that are off by one standard deviation, and they do.
CLUSTER_P: Final = 0.4

_EULER: Final = 0.5772156649015329


def largest_cluster(z: Array, chosen: Mask) -> int:
    """Size of the largest 4-connected group of chosen pixels of one sign with p < CLUSTER_P, over (H, W)."""
    from scipy.ndimage import label
    from scipy.special import ndtri

    limit = ndtri(1 - CLUSTER_P / 2)
    sizes = [np.bincount(label(chosen & (sign * z > limit))[0].ravel())[1:] for sign in (1, -1)]
    return int(max((size.max() for size in sizes if size.size), default=0))


def noise_clusters(chosen: Mask, simulations: int, seed: int) -> npt.NDArray[np.int64]:
    """Sizes (simulations,) of the largest cluster in images of white noise on a mask (H, W)."""
    generator = np.random.default_rng(seed)
    return np.array(
        [largest_cluster(generator.standard_normal(chosen.shape), chosen) for _ in range(simulations)]
    )


@dataclass(frozen=True)
class ClusterNoise:
    """How large the largest cluster of noise is on some mask: a Gumbel distribution, which maxima tend to.

    Attributes:
        location: of the distribution, in pixels.
        scale: of the distribution, in pixels; 0 where noise shows but one size.
    """

    location: float
    scale: float

    def p(self, size: int) -> float:
        """Chance that noise shows a cluster of at least this size in one colour."""
        if size == 0:
            return 1.0
        if self.scale == 0.0:
            return 1.0 if size <= self.location else 0.0
        return float(-np.expm1(-np.exp(-(size - 0.5 - self.location) / self.scale)))


def cluster_noise(chosen: Mask, simulations: int = 600, seed: int = 0) -> ClusterNoise:
    """Fit ``ClusterNoise`` to simulated noise on a mask (H, W) by its mean and standard deviation."""
    return _fitted(np.packbits(chosen).tobytes(), chosen.shape, simulations, seed)


@cache
def _fitted(packed: bytes, shape: tuple[int, int], simulations: int, seed: int) -> ClusterNoise:
    bits = np.unpackbits(np.frombuffer(packed, dtype=np.uint8), count=shape[0] * shape[1])
    sizes = noise_clusters(bits.reshape(shape).astype(bool), simulations, seed)
    scale = float(sizes.std()) * np.sqrt(6) / np.pi
    return ClusterNoise(float(sizes.mean()) - (_EULER * scale if scale else 0.0), scale)


#: Degrees of freedom above which a variance counts as known.
KNOWN: Final = 1e6


def shrink_variance(variance: Array, freedom: float, expected: Array) -> tuple[Array, float]:
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
