"""A z-test for tests of our own renderers: do two noisy images show the same radiance?

Method: Mitsuba 3's ``test_renders.py`` with the noise of the reference counted, and with a test of clusters:
    a
structured error of one standard deviation passes every single pixel, but noise does not cluster.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.metrics.clusters import largest_cluster, noise_clusters

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ZTest:
    """Outcome of ``z_test``.

    Attributes:
        z: signed z-scores, (H, W, C), 0 outside the mask.
        smallest_p: smallest two-sided p-value.
        p_limit: what it must not be below: Sidak's level for the number of values tested.
        failing: number of values below ``p_limit``.
        largest_cluster: size, in pixels, of the largest connected group of one sign with p < 0.4.
        cluster_limit: largest size that noise alone shows with the chosen confidence.
    """

    z: Array
    smallest_p: float
    p_limit: float
    failing: int
    largest_cluster: int
    cluster_limit: int

    @property
    def passed(self) -> bool:
        """Neither a pixel nor a cluster contradicts that both images show the same."""
        return self.failing == 0 and self.largest_cluster <= self.cluster_limit


def z_test(
    mean: npt.ArrayLike,
    variance: npt.ArrayLike,
    reference: npt.ArrayLike,
    reference_variance: npt.ArrayLike | float,
    *,
    mask: npt.ArrayLike | None = None,
    level: float = 0.01,
    allowance: npt.ArrayLike | float = 0.0,
    simulations: int = 600,
    seed: int = 0,
) -> ZTest:
    """Test whether two images, given with the variances of their pixels, have the same expectation.

    ``level`` is the chance of refusing equal images; half goes to the pixel test (Sidak over all values),
    half to the cluster test (its limit is found by simulating noise on the same mask). Noise is taken as
    normal and independent between pixels: use a box filter, and enough samples a pixel that its variance is
    known (with few, the tails are those of Student's t and the test refuses too often).

    Args:
        mean: (H, W, C).
        variance: (H, W, C), of ``mean`` itself, that is the sample variance over the number of samples.
        reference: (H, W, C).
        reference_variance: as ``variance``, or 0 for an exact reference.
        mask: (H, W); pixels above 0 are tested. All if not given.
        level: chance of refusing two equal images.
        allowance: known systematic difference that is not held against the image, in radiance: |difference|
            is reduced by it. State its cause where you use it.
        simulations: number of noise images behind the cluster limit.
        seed: of the simulated noise.

    Raises:
        InputError: for shapes that do not fit, a value that is not finite, a negative variance or allowance,
            or an empty mask.
    """
    difference, deviation, chosen = _checked(
        mean, variance, reference, reference_variance, mask, np.asarray(allowance, dtype=np.float64)
    )
    z = _scores(difference, deviation)
    z[~chosen] = 0
    p = _two_sided_p(z[chosen])
    half = level / 2
    p_limit = 1 - (1 - half) ** (1 / p.size)
    colours = z.shape[-1]
    noise = noise_clusters(chosen, simulations, seed)
    limit = int(np.quantile(noise, (1 - half) ** (1 / colours), method="higher"))
    largest = max(largest_cluster(z[..., c], chosen) for c in range(colours))
    return ZTest(z, float(p.min()), p_limit, int((p < p_limit).sum()), largest, limit)


def _scores(difference: Array, deviation: Array) -> Array:
    """z = difference / deviation; without any noise an equal pixel scores 0 and another one infinity."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(difference == 0, 0.0, difference / deviation)


def _two_sided_p(z: Array) -> Array:
    from scipy.special import erfc

    return np.asarray(erfc(np.abs(z) / np.sqrt(2)), dtype=np.float64)


def _checked(
    mean: Any, variance: Any, reference: Any, reference_variance: Any, mask: Any, allowance: Array
) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    image = np.asarray(mean, dtype=np.float64)
    sizes = check_shape("mean", image, "H W C")
    fields = {"variance": variance, "reference": reference, "reference_variance": reference_variance}
    arrays = {name: np.asarray(value, dtype=np.float64) for name, value in fields.items()}
    if arrays["reference_variance"].ndim == 0:
        arrays["reference_variance"] = np.full(image.shape, arrays["reference_variance"])
    for name, array in arrays.items():
        check_shape(name, array, "H W C", **sizes)
    arrays |= {"mean": image, "allowance": allowance}
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise InputError(f"{name}: NaN or inf found, finite values expected")
        if name in ("variance", "reference_variance", "allowance") and (array < 0).any():
            raise InputError(f"{name}: {array.min():.3g} found, 0 or more expected")
    weight = np.ones(image.shape[:2]) if mask is None else np.asarray(mask, dtype=np.float64)
    check_shape("mask", weight, "H W", H=sizes["H"], W=sizes["W"])
    if not (weight > 0).any():
        raise InputError("mask: no pixel above 0 found, at least one expected")
    raw = image - arrays["reference"]
    difference = np.sign(raw) * np.maximum(np.abs(raw) - allowance, 0)
    deviation = np.sqrt(arrays["variance"] + arrays["reference_variance"])
    return difference, deviation, np.asarray(weight > 0)
