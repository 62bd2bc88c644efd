"""How far a biased renderer is from a noisy reference, without counting the reference's noise.

With two independent renders R1, R2 of one scene, E[(S - R1)(S - R2)] = (S - R)^2 at every pixel: the noise of
the two does not correlate and drops out of the mean. A plain squared difference would add its variance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError, check_shape

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RelativeRmse:
    """Root-mean-square error of an image, divided by the reference's root-mean-square.

    Attributes:
        value: sqrt(bias^2 / mean square of the reference); 0 if the estimate of bias^2 is negative, which
            happens where noise hides the error.
        low: lower end of the bootstrap interval.
        high: upper end of the bootstrap interval.
        bias_squared: the estimate of the mean squared error itself, in squared radiance; may be negative.
    """

    value: float
    low: float
    high: float
    bias_squared: float


def bias_squared(
    image: npt.ArrayLike, first: npt.ArrayLike, second: npt.ArrayLike, mask: npt.ArrayLike
) -> float:
    """Estimate the mean of (image - truth)^2 from two independent noisy references, free of their noise.

    Args:
        image: (H, W, C), linear.
        first: reference (H, W, C).
        second: reference (H, W, C), rendered with another seed. Passing one render twice adds its variance.
        mask: (H, W), weights from 0 to 1.

    Returns:
        Weighted mean over pixels and colours, in squared radiance; unbiased, hence negative at times.

    Raises:
        InputError: for shapes that do not fit, values that are not finite, or an empty mask.
    """
    s, r1, r2, weight = _checked(image, first, second, mask)
    return _mean((s - r1) * (s - r2), weight)


def relative_rmse(
    image: npt.ArrayLike,
    first: npt.ArrayLike,
    second: npt.ArrayLike,
    mask: npt.ArrayLike,
    *,
    again: npt.ArrayLike | None = None,
    level: float = 0.95,
    block: int = 8,
    draws: int = 2000,
    seed: int = 0,
) -> RelativeRmse:
    """Relative RMS error, free of the references' noise, with a bootstrap interval.

    The error of a shading model is smooth, so neighbouring pixels are no independent evidence: blocks of
    ``block`` x ``block`` pixels are drawn, not pixels. The interval is the percentile interval. It covers
    the noise and the choice of pixels, not other scenes.

    Args:
        image, first, second, mask: as in ``bias_squared``.
        again: a second image of the same renderer with other noise; the noise of both is then left out too.
        level: coverage of the interval.
        block: edge of a block in pixels.
        draws: number of bootstrap samples.
        seed: of the generator that draws the blocks.

    Raises:
        InputError: as ``bias_squared``; also for a mask within a single block, or a black reference.
    """
    s, r1, r2, weight = _checked(image, first, second, mask)
    other = s if again is None else _checked(again, first, second, mask)[0]
    difference = (s - r1) * (other - r2)
    error = _block_sums(difference, weight, block)
    power = _block_sums(r1 * r2, weight, block)
    used = _block_sums(np.ones_like(s), weight, block) > 0
    error, power = error[used], power[used]
    if error.size < 2:
        raise InputError(f"mask: {error.size} block of {block}x{block} pixels found, at least 2 expected")
    if power.sum() <= 0:
        raise InputError("reference: mean square 0 or less found inside the mask, a lit reference expected")
    generator = np.random.default_rng(seed)
    chosen = generator.integers(error.size, size=(draws, error.size))
    drawn_error, drawn_power = error[chosen].sum(axis=1), power[chosen].sum(axis=1)
    lit = drawn_power > 0  # a draw of dark blocks only says nothing about the ratio
    ratios = np.sqrt(np.maximum(drawn_error[lit], 0) / drawn_power[lit])
    low, high = np.quantile(ratios, [(1 - level) / 2, (1 + level) / 2])
    value = math.sqrt(max(error.sum(), 0) / power.sum())
    return RelativeRmse(value, float(low), float(high), _mean(difference, weight))


def worst_block(
    image: npt.ArrayLike, first: npt.ArrayLike, second: npt.ArrayLike, mask: npt.ArrayLike, block: int = 8
) -> float:
    """RMS error of the square block of pixels that is worst, over the reference's RMS in the whole image.

    Free of the references' noise as ``relative_rmse``; of many blocks with equal errors it still takes the
    one that noise favours. Blocks of which less than half is counted have no say.

    Args:
        image, first, second, mask: as in ``bias_squared``.
        block: edge of a block in pixels.

    Raises:
        InputError: as ``bias_squared``; also if no block is counted to a half.
    """
    s, r1, r2, weight = _checked(image, first, second, mask)
    count = _block_sums(np.ones_like(s), weight, block)
    full = count >= 0.5 * s.shape[-1] * block * block
    if not full.any():
        raise InputError(f"mask: no block of {block}x{block} pixels found of which half is counted")
    error = _block_sums((s - r1) * (s - r2), weight, block)[full] / count[full]
    return math.sqrt(max(float(error.max()), 0.0) / _mean(r1 * r2, weight))


def _checked(image: Any, first: Any, second: Any, mask: Any) -> tuple[Array, Array, Array, Array]:
    named = {"image": image, "first": first, "second": second, "mask": mask}
    arrays = {name: np.asarray(value, dtype=np.float64) for name, value in named.items()}
    sizes = check_shape("image", arrays["image"], "H W C")
    for name in ("first", "second"):
        check_shape(name, arrays[name], "H W C", **sizes)
    check_shape("mask", arrays["mask"], "H W", H=sizes["H"], W=sizes["W"])
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise InputError(f"{name}: NaN or inf found, finite values expected")
    if (arrays["mask"] < 0).any() or arrays["mask"].sum() <= 0:
        raise InputError("mask: negative or no weight at all found, weights from 0 to 1 expected")
    return arrays["image"], arrays["first"], arrays["second"], arrays["mask"]


def _mean(values: Array, weight: Array) -> float:
    return float(np.sum(values * weight[..., None]) / (values.shape[-1] * weight.sum()))


def _block_sums(values: Array, weight: Array, block: int) -> Array:
    """Weighted sums over colours and square blocks of pixels, flat; edge blocks may be smaller."""
    summed = (values * weight[..., None]).sum(axis=-1)
    rows = np.add.reduceat(summed, np.arange(0, summed.shape[0], block), axis=0)
    return np.add.reduceat(rows, np.arange(0, summed.shape[1], block), axis=1).ravel()
