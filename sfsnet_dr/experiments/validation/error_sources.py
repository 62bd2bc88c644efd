"""Why an image is wrong: its error against the path tracer, split by cause without noise.

Method. Between a shading model's image S and the truth T stand images that differ from their neighbours in
one thing each. For order l without visibility they are, with the cause between one line and the next:

    S                       order l, shaded from one mean normal and albedo a pixel
        filter              shading is not linear in the normal: pixels that hold several normals are off
    U_l                     order l, shaded at 4 x 4 points of each pixel, then averaged
        truncation          light and cosine beyond order l
    U                       all bands (closed form for lamps, quadrature for maps), nothing shadows anything
        visibility          cast shadows, sky that is hidden by the surface
    D                       path traced, light that meets the surface once
        interreflection     light that meets it more often
    P                       path traced, diffuse
        gloss               what the interface mirrors, and what it keeps from the body
    T                       path traced, all that the subject has

Models with visibility join where they belong: S and D differ by truncation alone, S with one bounce and the
one-bounce image likewise; the noise of their own capture is told apart from it.

With e = S - T and the steps d_k, e = sum_k d_k, so mean(e^2) = sum_k mean(e d_k) exactly. The k-th term over
mean(e^2) is the cause's *share* of the squared error; it is negative where a cause offsets the others. The
*size* of a cause is sqrt(mean(d_k^2)) over the RMS of T: how much the image changes when it is mended alone.
Both use products of the two independent families of ``study.levels``, which keeps noise out.

Left out: the truth is RGB; what a spectral renderer would change is measured apart (``study.compared``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from sfsnet_dr.experiments.validation.references import IndependentPair

Image = npt.NDArray[np.float64]
Cause = Literal["filter", "truncation", "visibility", "interreflection", "gloss", "noise"]

#: All causes, from the pixel to the surface.
CAUSES: Final[tuple[Cause, ...]] = (
    "filter",
    "truncation",
    "visibility",
    "interreflection",
    "gloss",
    "noise",
)


@dataclass(frozen=True)
class ErrorPart:
    """What one cause does.

    Attributes:
        size: relative RMS change of the image by this cause alone, at least 0.
        share: of the squared error; all shares of an image add up to 1. May be negative.
    """

    size: float
    share: float


@dataclass(frozen=True)
class ErrorStep:
    """Two neighbouring images: ``upper`` is nearer to the model, ``lower`` to the truth."""

    cause: Cause
    upper: IndependentPair
    lower: IndependentPair


def decompose_error(steps: list[ErrorStep], mask: Image, noise: float = 0.0) -> dict[Cause, ErrorPart]:
    """Split an error.

    Args:
        steps: from the model to the truth; each begins where the one before ends.
        mask: (H, W), weights from 0 to 1.
        noise: mean squared error of the model's image that is noise of its own capture, in squared radiance;
            taken out of the step ``truncation``, which holds it.

    Returns:
        A part for each cause; causes that no step has are 0. Where the squared error is not above 0, as for
        an image without any, the shares are 0 too.
    """
    model, truth = steps[0].upper, steps[-1].lower
    error = IndependentPair(model.first - truth.first, model.second - truth.second)
    power = _product(IndependentPair(truth.first, truth.second), mask)
    total = _product(error, mask)
    shares, squares = dict.fromkeys(CAUSES, 0.0), dict.fromkeys(CAUSES, 0.0)
    for step in steps:
        change = IndependentPair(step.upper.first - step.lower.first, step.upper.second - step.lower.second)
        crossed = (IndependentPair(error.first, change.second), IndependentPair(change.first, error.second))
        shares[step.cause] += sum(_product(pair, mask) for pair in crossed) / 2
        squares[step.cause] += _product(change, mask)
    for values in (shares, squares):
        values["truncation"] -= noise
        values["noise"] += noise
    whole = total if total > 0 else float("inf")
    return {
        cause: ErrorPart(float(np.sqrt(max(squares[cause], 0.0) / power)), shares[cause] / whole)
        for cause in CAUSES
    }


def _product(pair: IndependentPair, mask: Image) -> float:
    weighted = (pair.first * pair.second) * mask[..., None]
    return float(weighted.sum() / (weighted.shape[-1] * mask.sum()))
