"""Mixtures of normal distributions by expectation and maximisation.

Written out because it is forty lines, and a learning library would be a dependency for one command. Source:
Bishop, Pattern Recognition and Machine Learning (2006), section 9.2.2; starts as k-means++ does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.checks import BadInput, check_shape

Array = npt.NDArray[np.float64]

_ROUNDS: Final = 200
_CLOSE_ENOUGH: Final = 1e-5


@dataclass(frozen=True, eq=False)
class Mixture:
    """K normal distributions in D dimensions.

    Attributes:
        shares: (K,).
        means: (K, D).
        factors: lower triangular roots of the covariances, (K, D, D).
        likelihood: mean log-likelihood of the data in each round.
    """

    shares: Array
    means: Array
    factors: Array
    likelihood: tuple[float, ...]

    def log_likelihood(self, rows: Array) -> Array:
        """Logarithm of the density at rows (N, D), (N,)."""
        return _total(_weighted_logs(rows, self.shares, self.means, self.factors))


def fit_mixture(rows: Array, components: int, seed: int = 0, floor: float = 1e-4) -> Mixture:
    """Fit a mixture with full covariances.

    Args:
        rows: (N, D), N above components * D.
        components: K.
        seed: of the start.
        floor: variance that is added to every component along every axis.

    Raises:
        BadInput: for too few rows, or rows that are not finite.
    """
    sizes = check_shape("rows", rows, "N D")
    if sizes["N"] <= components * sizes["D"] or not np.isfinite(rows).all():
        raise BadInput(
            f"mixture: {sizes['N']} finite rows found, more than {components * sizes['D']} are needed "
            f"for {components} components in {sizes['D']} dimensions"
        )
    belonging = _start(rows, components, np.random.default_rng(seed))
    told: list[float] = []
    while True:
        shares, means, factors = _maximise(rows, belonging, floor)
        logs = _weighted_logs(rows, shares, means, factors)
        total = _total(logs)
        told.append(float(total.mean()))
        if len(told) >= _ROUNDS or (len(told) > 1 and told[-1] - told[-2] < _CLOSE_ENOUGH):
            return Mixture(shares, means, factors, tuple(told))
        belonging = np.exp(logs - total[:, None])


def _start(rows: Array, components: int, rng: np.random.Generator) -> Array:
    """Rows belong to the clusters of k-means, (N, K)."""
    from scipy.cluster.vq import kmeans2

    scaled = rows / np.maximum(rows.std(axis=0), 1e-12)
    label = kmeans2(scaled, components, iter=20, minit="++", rng=rng)[1]
    return np.asarray(label[:, None] == np.arange(components), np.float64)


def _weighted_logs(rows: Array, shares: Array, means: Array, factors: Array) -> Array:
    parts = [_log_density(rows, *part) for part in zip(means, factors, strict=True)]
    return np.asarray(np.log(shares) + np.stack(parts, axis=1))


def _total(logs: Array) -> Array:
    top = logs.max(axis=1, keepdims=True)
    return np.asarray(top[:, 0] + np.log(np.exp(logs - top).sum(axis=1)))


def _maximise(rows: Array, belonging: Array, floor: float) -> tuple[Array, Array, Array]:
    count = belonging.sum(axis=0) + 1e-9
    means = belonging.T @ rows / count[:, None]
    factors = []
    for k, mean in enumerate(means):
        apart = rows - mean
        spread = (apart * belonging[:, k : k + 1]).T @ apart / count[k]
        factors.append(np.linalg.cholesky(spread + floor * np.eye(rows.shape[1])))
    return count / count.sum(), means, np.array(factors)


def _log_density(rows: Array, mean: Array, factor: Array) -> Array:
    from scipy.linalg import solve_triangular

    white = solve_triangular(factor, (rows - mean).T, lower=True)
    size = len(mean)
    return np.asarray(
        -0.5 * ((white**2).sum(axis=0) + size * np.log(2 * np.pi)) - np.log(np.diag(factor)).sum()
    )
