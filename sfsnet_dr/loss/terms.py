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


class Trust(NamedTuple):
    """How far labels are trusted, 0 to 1.

    Args:
        pixels: of normals and albedo, (B, 1, H, W). It weights their errors but not the number that they are
            divided by, so that faces with doubtful labels pull less.
        light: of the light, (B,).
    """

    pixels: Tensor
    light: Tensor


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
    trust: Trust | None = None,
    share: Share | None = None,
) -> LossTerms:
    """The paper's total loss, eq. 2, with its terms.

    Args:
        prediction: what the network gave; half precision is raised to float32 here.
        target: ground truth or pseudo-labels; constants, they get no gradient.
        weights: the paper's if none are given.
        backend: who computes the reconstruction term, see ``reconstruction_l1``.
        trust: in the labels; whole if not given. Reconstruction, which needs no label, is not weighted.
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
    pixels = None if trust is None else trust.pixels
    if pixels is not None:
        check_shape("trust.pixels", pixels, "B 1 H W", B=batch, H=height, W=width)
    normal = masked_l1(prediction.normal, target.normal, target.mask, pixels)
    albedo = masked_l1(prediction.albedo, target.albedo, target.mask, pixels)
    light = _light_l2(prediction.light, target.light, None if trust is None else trust.light)
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


def _light_l2(predicted: Tensor, target: Tensor, trust: Tensor | None) -> Tensor:
    """Mean squared error of the coefficients, each face weighted by its trust."""
    squared = (_at_least_float32(predicted) - target.detach()).square()
    if trust is None:
        return squared.mean()
    check_shape("trust.light", trust, "B", B=len(predicted))
    return (squared * trust[:, None]).mean()


def _at_least_float32(tensor: Tensor) -> Tensor:
    return tensor if tensor.element_size() >= 4 else tensor.float()
