"""Do two noisy images show the same radiance? Tests per pixel, per block and per cluster.

A pixel alone sees a spark or a wrong edge; a cluster sees what is weak but joined; means over blocks and over
the picture see an error of a thousandth that no pixel shows. Method: Mitsuba 3's ``test_renders.py`` and
``render.ztest``, with the noise of both images counted and its variance not taken as known: where it comes
from a few renders with different seeds, scores follow Student's t. Sums over blocks have degrees of freedom
enough (Satterthwaite); the variances of pixels are moderated first (``render.moderation``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.metrics.clusters import KNOWN, cluster_noise, largest_cluster, shrink_variance

Array = npt.NDArray[np.float64]

#: Edges of the blocks whose means are compared, in pixels.
BLOCKS: Final = (8, 32)

#: A score that says no more than "beyond all chance": its p underflows.
ENDLESS: Final = 38.0


@dataclass(frozen=True, eq=False)
class Estimate:
    """An image that is known up to noise.

    Attributes:
        mean: (H, W, 3).
        variance: (H, W, 3), of the mean; 0 for an image without noise.
        freedom: degrees of freedom behind every variance; infinite where it is known.
    """

    mean: Array
    variance: Array
    freedom: float = np.inf

    def __post_init__(self) -> None:
        sizes = check_shape("mean", self.mean, "H W 3")
        check_shape("variance", self.variance, "H W 3", **sizes)
        for name, values in (("mean", self.mean), ("variance", self.variance)):
            if not np.isfinite(values).all():
                raise InputError(f"{name}: NaN or inf found, finite values expected")
        if (self.variance < 0).any() or not self.freedom > 0:
            raise InputError("variance: negative, or no degree of freedom, found")


def exact_estimate(image: npt.ArrayLike) -> Estimate:
    """An image (H, W, 3) without noise."""
    mean = np.asarray(image, dtype=np.float64)
    return Estimate(mean, np.zeros_like(mean))


def estimate_from_seeds(images: Sequence[npt.ArrayLike]) -> Estimate:
    """The mean of images (H, W, 3) rendered with different seeds, its variance taken from their spread.

    Raises:
        InputError: for fewer than 2 images.
    """
    if len(images) < 2:
        raise InputError(f"images: {len(images)} found, at least 2 are needed for a variance")
    stack = np.stack([np.asarray(image, dtype=np.float64) for image in images])
    return Estimate(stack.mean(axis=0), stack.var(axis=0, ddof=1) / len(stack), len(stack) - 1.0)


@dataclass(frozen=True)
class Scale:
    """What one kind of test found.

    Attributes:
        name: ``pixel``, ``cluster``, ``block of 8``, ``picture`` and so on.
        worst: the score farthest from 0, as z; for clusters the largest size in pixels.
        p: chance that noise alone shows a worse one anywhere in the image, at this scale.
    """

    name: str
    worst: float
    p: float


@dataclass(frozen=True, eq=False)
class Agreement:
    """Outcome of ``check_agreement``.

    Attributes:
        z: (H, W, 3) score of every pixel.
        scales: what each kind of test found.
        p: chance that equal images differ as much at the worst of all scales.
    """

    z: Array
    scales: tuple[Scale, ...]
    p: float

    @property
    def worst(self) -> Scale:
        """The scale that speaks most strongly against the images being equal."""
        return min(self.scales, key=lambda scale: scale.p)

    @property
    def worst_z(self) -> float:
        """The score farthest from 0 among pixels, blocks and the picture."""
        scores = [scale.worst for scale in self.scales if scale.name != "cluster"]
        return max(scores, key=abs)

    def p_among(self, tests: int) -> float:
        """Chance that any of so many pairs of equal images differs as much (Sidak)."""
        return sidak_threshold(self.p, tests)


def check_agreement(
    image: Estimate, reference: Estimate, *, allowance: npt.ArrayLike | float = 0.0
) -> Agreement:
    """Test whether an image and a reference have the same expectation.

    Noise is taken as independent between pixels: box filters on both sides.

    Args:
        image: what is tested.
        reference: what it is held against.
        allowance: (H, W, 3) or one number; a known systematic difference that is not held against the image,
            in radiance. It may have one sign everywhere, so blocks are allowed its sum. State its cause.

    Raises:
        InputError: for shapes that do not fit.
    """
    sizes = check_shape("image", image.mean, "H W 3")
    check_shape("reference", reference.mean, "H W 3", **sizes)
    raw = image.mean - reference.mean
    allowed = np.broadcast_to(np.asarray(allowance, dtype=np.float64), raw.shape)
    steady, freedom = _moderated(image, reference)
    total = steady + reference.variance
    z = _as_z(_shrunk(raw, allowed), total, np.full(total.shape, min(freedom, reference.freedom)))
    scales = [_scale("pixel", z), _cluster_scale(z, total > 0)]
    longest = max(raw.shape[:2])
    for block in (*(b for b in BLOCKS if b < longest), longest):
        name = "picture" if block == longest else f"block of {block}"
        scales.append(_scale(name, _block_scores(image, steady, reference, raw, allowed, block)))
    smallest = min(scale.p for scale in scales)
    return Agreement(z, tuple(scales), sidak_threshold(smallest, len(scales)))


def sidak_threshold(p: float, tests: int) -> float:
    """Chance that the smallest of so many independent p-values is as small as p."""
    if p >= 1.0:
        return 1.0
    return float(-np.expm1(tests * np.log1p(-p)))


def two_sided_p(z: Array) -> Array:
    """Chance of a normal score at least as far from 0."""
    from scipy.special import erfc

    return np.asarray(erfc(np.abs(z) / np.sqrt(2)), dtype=np.float64)


def _moderated(image: Estimate, reference: Estimate) -> tuple[Array, float]:
    """The image's variances moderated by the reference's, or by their own, and their freedom.

    A pixel is expected to be at least as noisy as the 3 x 3 around it: at an edge a rare ray may have missed
    a pixel in all samples of the reference. Scores then take the smaller freedom of image and reference:
    Welch's is itself estimated, and so far out in the tail an estimate that is too good fails.
    """
    from scipy.ndimage import uniform_filter

    known = reference.variance if reference.variance.any() else image.variance
    around = np.maximum(uniform_filter(known, size=(3, 3, 1)), 0.0)
    expected = np.maximum(reference.variance, around)
    return shrink_variance(image.variance, image.freedom, expected)


def _block_scores(
    image: Estimate, steady: Array, reference: Estimate, raw: Array, allowed: Array, block: int
) -> Array:
    """Scores of sums over square blocks, (rows, columns, 3); blocks at the edge may be smaller."""
    difference = _shrunk(_sums(raw, block), _sums(allowed, block))
    # Blocks at an edge may hold few noisy pixels, and no spread at all by luck.
    own = np.maximum(_sums(image.variance, block), _sums(steady, block))
    total = own + _sums(reference.variance, block)
    # Satterthwaite: squares of variances, each over its degrees of freedom, add up.
    fourth = _sums(image.variance**2, block) / image.freedom
    fourth = fourth + _sums(reference.variance**2, block) / reference.freedom
    freedom = np.divide(total**2, fourth, out=np.full_like(total, np.inf), where=fourth > 0)
    return _as_z(difference, total, freedom)


def _as_z(difference: Array, variance: Array, freedom: Array) -> Array:
    """The normal score that is as unlikely as difference / deviation is under Student's t."""
    from scipy.special import ndtr, ndtri, stdtr

    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        t = np.where(difference == 0, 0.0, np.abs(difference) / np.sqrt(variance))
    known = freedom >= KNOWN
    tail = np.where(known, ndtr(-t), stdtr(np.where(known, KNOWN, freedom), -t))
    with np.errstate(divide="ignore"):
        z = np.minimum(-ndtri(tail), ENDLESS)
    return np.asarray(np.sign(difference) * np.abs(z))


def _scale(name: str, z: Array) -> Scale:
    worst = float(z.ravel()[np.abs(z).argmax()])
    return Scale(name, worst, sidak_threshold(float(two_sided_p(np.asarray(abs(worst)))), z.size))


def _cluster_scale(z: Array, noisy: npt.NDArray[np.bool_]) -> Scale:
    """The largest cluster of one colour. Where there is no noise at all, pixels decide alone."""
    chosen = np.asarray(noisy.any(axis=-1))
    if not chosen.any():
        return Scale("cluster", 0.0, 1.0)
    sizes = [largest_cluster(z[..., colour], chosen) for colour in range(3)]
    return Scale("cluster", float(max(sizes)), sidak_threshold(cluster_noise(chosen).p(max(sizes)), 3))


def _shrunk(raw: Array, allowed: Array) -> Array:
    return np.asarray(np.sign(raw) * np.maximum(np.abs(raw) - allowed, 0.0))


def _sums(values: Array, block: int) -> Array:
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], block), axis=0)
    return np.asarray(np.add.reduceat(rows, np.arange(0, values.shape[1], block), axis=1))
