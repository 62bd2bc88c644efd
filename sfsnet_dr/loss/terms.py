"""The four terms of SfSNet's training loss.

Source: Sengupta et al., CVPR 2018, section 3.2, E = .5 E_recon + .5 E_N + .5 E_A + .1 E_L: L1 over the pixels
of the face for reconstruction, normals and albedo, L2 over the 27 light coefficients.

Departure: the paper writes sums over pixels and leaves the normalisation of E_L open. Here every term is the
mean over the numbers that it counts (for E_L the mean of the squared differences of B x 27 coefficients), so
that the weights mean the same for any image size, face size and batch size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from torch import Tensor

from sfsnet_dr.base.checks import check_shape
from sfsnet_dr.base.conventions import LIGHT_SIZE
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.loss.reconstruction import Backend, reconstruction_l1
from sfsnet_dr.model.outputs import Decomposition


@dataclass(frozen=True)
class LossWeights:
    """Weights of the four terms; the defaults are the paper's lambdas."""

    recon: float = 0.5
    normal: float = 0.5
    albedo: float = 0.5
    light: float = 0.1


class Share(NamedTuple):
    """What a process has of a batch that several share: of its mask's pixels, and of its images."""

    pixels: Tensor
    images: float


class LossTerms(NamedTuple):
    """Scalar tensors: the weighted total, and the four terms before weighting."""

    total: Tensor
    recon: Tensor
    normal: Tensor
    albedo: Tensor
    light: Tensor


def sfsnet_loss(
    prediction: Decomposition,
    target: FaceBatch,
    weights: LossWeights | None = None,
    backend: Backend = "drjit",
    confidence: Tensor | None = None,
    share: Share | None = None,
) -> LossTerms:
    """The paper's total loss, eq. 2, with its terms.

    Args:
        prediction: what the network gave; half precision is raised to float32 here.
        target: ground truth or pseudo-labels; constants, they get no gradient.
        weights: the paper's if none are given.
        backend: who computes the reconstruction term, see ``reconstruction_l1``.
        confidence: (B, 1, H, W) in [0, 1], how far the labels are trusted; fully if not given. It weights the
            errors of normals and albedo but not the number that they are divided by, so that faces with
            doubtful labels pull less; light is weighted by the mean over its face. Reconstruction, which
            needs no label, is not.
        share: what this is of a larger batch; the terms are then those parts that add up to the batch's.

    Raises:
        BadInput: naming the field whose shape does not fit.
    """
    weights = weights or LossWeights()
    target.check()
    batch, _, height, width = target.image.shape
    check_shape("prediction.normal", prediction.normal, "B 3 H W", B=batch, H=height, W=width)
    check_shape("prediction.albedo", prediction.albedo, "B 3 H W", B=batch, H=height, W=width)
    check_shape("prediction.light", prediction.light, f"B {LIGHT_SIZE}", B=batch)
    recon = reconstruction_l1(
        *prediction, target.image, target.mask, backend=backend, expected_gradient=weights.recon
    )
    normal = masked_l1(prediction.normal, target.normal, target.mask, confidence)
    albedo = masked_l1(prediction.albedo, target.albedo, target.mask, confidence)
    light = _light_l2(prediction.light, target, confidence)
    if share is not None:
        recon, normal, albedo = (share.pixels * term for term in (recon, normal, albedo))
        light = share.images * light
    total = weights.recon * recon + weights.normal * normal + weights.albedo * albedo + weights.light * light
    return LossTerms(total, recon, normal, albedo, light)


def masked_l1(predicted: Tensor, target: Tensor, mask: Tensor, confidence: Tensor | None = None) -> Tensor:
    """sum mask confidence |predicted - target| / max(C sum mask, 1) over (B, C, H, W), mask (B, 1, H, W)."""
    difference = (_at_least_float32(predicted) - target.detach()).abs()
    weight = mask.detach() if confidence is None else (mask * confidence).detach()
    return (weight * difference).sum() / (predicted.shape[1] * mask.detach().sum()).clamp_min(1)


def _light_l2(predicted: Tensor, target: FaceBatch, confidence: Tensor | None) -> Tensor:
    """Mean squared error of the coefficients, each face weighted by its mean confidence."""
    squared = (_at_least_float32(predicted) - target.light.detach()).square()
    if confidence is None:
        return squared.mean()
    check_shape("confidence", confidence, "B 1 H W", B=len(target.mask))
    face = target.mask.sum((1, 2, 3)).clamp_min(1)
    return (squared * ((target.mask * confidence).sum((1, 2, 3)) / face)[:, None]).mean()


def _at_least_float32(tensor: Tensor) -> Tensor:
    return tensor if tensor.element_size() >= 4 else tensor.float()
