"""SfSNet's training loss: four terms over rendered and real faces.

Source: Sengupta et al., CVPR 2018, section 3.2, E = 0.5 E_recon + 0.5 E_N + 0.5 E_A + 0.1 E_L: L1 over
the pixels of the face for reconstruction, normals and albedo, L2 over the 27 light coefficients.

Departure: the paper writes sums over pixels and leaves the normalisation of E_L open. Here every term is the
mean over the numbers that it counts (for E_L the mean of the squared differences of B x 27 coefficients), so
that the weights mean the same for any image size, face size and batch size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import torch
from torch import Tensor

from sfsnet_dr.core.conventions import LIGHT_SIZE
from sfsnet_dr.core.errors import check_shape
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.mixed_batch import MixedBatch, RealBatch
from sfsnet_dr.losses.reconstruction import Backend, reconstruction_l1
from sfsnet_dr.models.base import NetworkOutput


@dataclass(frozen=True)
class LossWeights:
    """Weights of the four terms; the defaults are the paper's lambdas."""

    recon: float = 0.5
    normal: float = 0.5
    albedo: float = 0.5
    light: float = 0.1


class BatchShare(NamedTuple):
    """What a process has of a batch that several share: of its mask's pixels, and of its images."""

    pixels: Tensor
    images: float


class LabelConfidence(NamedTuple):
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
    prediction: NetworkOutput,
    target: FaceBatch,
    weights: LossWeights | None = None,
    backend: Backend = "drjit",
    trust: LabelConfidence | None = None,
    share: BatchShare | None = None,
) -> LossTerms:
    """The paper's total loss, eq. 2, with its terms.

    Args:
        prediction: what the network gave; half precision is raised to float32 here.
        target: ground truth or pseudo-labels; constants, they get no gradient.
        weights: the paper's if none are given.
        backend: who computes the reconstruction term, see ``reconstruction_l1``.
        trust: in the labels; whole if not given. Reconstruction, which needs no label, is not weighted.
        share: what this is of a larger batch; the terms are then those parts that add up to the batch's.

    Returns:
        The weighted total and the four terms before weighting, scalar tensors.

    Raises:
        InputError: naming the field whose shape does not fit.

    Source: Sengupta et al., SfSNet, CVPR 2018, section 3.2.

    Example:
        >>> import torch
        >>> import sfsnet_dr as sf
        >>> from sfsnet_dr.data.batch import FaceBatch
        >>> image = torch.full((1, 3, 128, 128), 0.3)
        >>> output = sf.SkipNet(8)(image)
        >>> ones = torch.ones(1, 1, 128, 128)
        >>> truth = FaceBatch(image, *(part.detach() for part in output), ones)
        >>> terms = sf.sfsnet_loss(output, truth)
        >>> terms.normal.item(), terms.light.item()
        (0.0, 0.0)
        >>> terms.total.backward()
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


#: Of a label whose scale is free: what people's skin and a database's exposures differ by.
LARGEST_FACTOR: Final = 2.0


def mixed_loss(
    prediction: NetworkOutput,
    target: MixedBatch,
    labelled_weights: LossWeights,
    real_weights: LossWeights,
    backend: Backend = "drjit",
    shares: tuple[BatchShare, BatchShare] | None = None,
) -> tuple[Tensor, LossTerms, LossTerms]:
    """The mean over all faces of a batch, each kind with weights of its own.

    Args:
        prediction: for ``target.image``, that is for the labelled faces first.
        target: both kinds.
        labelled_weights: of the terms of labelled faces.
        real_weights: of the terms of real faces; reconstruction against the photograph counts wherever their
            mask is, pseudo-supervision as far as it is trusted.
        backend: who computes the reconstruction terms.
        shares: what this is of a larger batch, of the labelled and of the real faces.

    Returns:
        Total, terms of the labelled faces, terms of the real ones.
    """
    count, real = len(target.labelled.image), len(target.real.faces.image)
    first = NetworkOutput(*(part[:count] for part in prediction))
    second = NetworkOutput(*(part[count:] for part in prediction))
    of_labelled, of_real = shares or (None, None)
    labelled_terms = sfsnet_loss(first, target.labelled, labelled_weights, backend, share=of_labelled)
    labels = match_albedo_scale(second, target.real)
    trust = LabelConfidence(target.real.confidence, light_confidence(labels.light, target.real))
    real_terms = sfsnet_loss(second, labels, real_weights, backend, trust, of_real)
    total = (count * labelled_terms.total + real * real_terms.total) / (count + real)
    return total, labelled_terms, real_terms


def match_albedo_scale(prediction: NetworkOutput, target: RealBatch) -> FaceBatch:
    """The labels; where scale is free, albedo has the prediction's mean, and light the inverse factor.

    The mean is over the mask, weighted by confidence; the factor is at most 2 either way, for labels have the
    scale of usual skin already. It is a constant to the gradient, so that no prediction is better for being
    darker. A least-squares one is too small where the prediction lacks detail, and let albedo sink to a third
    within 1,700 steps.
    """
    real = target.faces
    with torch.no_grad():
        weight = real.mask * target.confidence
        wanted, told = ((weight * part).sum((1, 2, 3)) for part in (prediction.albedo.float(), real.albedo))
        fitted = (wanted / told.clamp_min(1e-6)).clamp(1 / LARGEST_FACTOR, LARGEST_FACTOR)
        factor = torch.where(target.free_scale & (told > 0), fitted, torch.ones_like(fitted))
    return real._replace(albedo=real.albedo * factor[:, None, None, None], light=real.light / factor[:, None])


def light_confidence(light: Tensor, target: RealBatch) -> Tensor:
    """How far lights (B, 27) are trusted, (B,); where scale is free, less if their mean square is above 1.

    A lamp behind a face leaves its picture nearly black. What brings that into the range of usual exposures
    multiplies the lamp by hundreds, and in a sum of squares that one light would outweigh all others: it
    counts by its relative error.
    """
    relative = 1 / light.square().mean(1).clamp_min(1)
    return target.light_trust * torch.where(target.free_scale, relative, torch.ones_like(relative))
