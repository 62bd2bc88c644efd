"""The training loss over a batch of rendered and real faces."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor

from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.mixture import MixedBatch
from sfsnet_dr.data.real_batch import RealBatch
from sfsnet_dr.loss.reconstruction import Backend
from sfsnet_dr.loss.terms import LossTerms, LossWeights, Share, Trust, sfsnet_loss
from sfsnet_dr.model.outputs import Decomposition

#: Of a label whose scale is free: what people's skin and a database's exposures differ by.
LARGEST_FACTOR: Final = 2.0


def mixed_loss(
    prediction: Decomposition,
    target: MixedBatch,
    labelled_weights: LossWeights,
    real_weights: LossWeights,
    backend: Backend = "drjit",
    shares: tuple[Share, Share] | None = None,
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
    first = Decomposition(*(part[:count] for part in prediction))
    second = Decomposition(*(part[count:] for part in prediction))
    of_labelled, of_real = shares or (None, None)
    labelled_terms = sfsnet_loss(first, target.labelled, labelled_weights, backend, share=of_labelled)
    labels = at_scale_of(second, target.real)
    trust = Trust(target.real.confidence, light_trust(labels.light, target.real))
    real_terms = sfsnet_loss(second, labels, real_weights, backend, trust, of_real)
    total = (count * labelled_terms.total + real * real_terms.total) / (count + real)
    return total, labelled_terms, real_terms


def at_scale_of(prediction: Decomposition, target: RealBatch) -> FaceBatch:
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


def light_trust(light: Tensor, target: RealBatch) -> Tensor:
    """How far lights (B, 27) are trusted, (B,); where scale is free, less if their mean square is above 1.

    A lamp behind a face leaves its picture nearly black. What brings that into the range of usual exposures
    multiplies the lamp by hundreds, and in a sum of squares that one light would outweigh all others: it
    counts by its relative error.
    """
    relative = 1 / light.square().mean(1).clamp_min(1)
    return target.light_trust * torch.where(target.free_scale, relative, torch.ones_like(relative))
