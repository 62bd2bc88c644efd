"""One optimiser step, and the refusal of one whose numbers are not finite."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.mixture import MixedBatch
from sfsnet_dr.fit.collapse import spread_ratios
from sfsnet_dr.fit.recipe import Recipe
from sfsnet_dr.loss.mixture import mixed_loss
from sfsnet_dr.loss.terms import LossTerms, sfsnet_loss
from sfsnet_dr.model.network import Network
from sfsnet_dr.model.outputs import Decomposition


class NotFinite(Exception):
    """A batch gave NaN or infinity; the network and its optimiser are as they were before it."""


def training_step(
    model: Network, adam: torch.optim.Adam, batch: FaceBatch | MixedBatch, recipe: Recipe, rate: float
) -> dict[str, float]:
    """Learn from one batch.

    Args:
        model: in training mode.
        adam: its optimiser.
        batch: in float32, contiguous.
        recipe: precision, memory order, loss and largest gradient are taken from it.
        rate: learning rate of this step.

    Returns:
        The loss and its terms before the step; of a mixed batch those of the labelled faces, and those of the
        real ones as ``real_recon`` and so on. ``gradient`` is the norm of the gradient before clipping,
        ``normal_spread`` and ``albedo_spread`` are the ratios of ``fit.collapse``.

    Raises:
        NotFinite: if the loss or the gradient is not finite; nothing has been changed then, batch
            normalisation's running statistics included.
    """
    statistics = [(buffer, buffer.clone()) for buffer in model.buffers()]
    try:
        total, terms, ratios = _forward(model, batch, recipe)
        values = {name: float(term.detach()) for name, term in terms.items()}
        adam.zero_grad(set_to_none=True)
        values["gradient"] = _backward(model, total, recipe.optimiser.largest_gradient)
        values |= {f"{name}_spread": ratio for name, ratio in ratios.items()}
        bad = [name for name, value in values.items() if not torch.isfinite(torch.tensor(value))]
        if bad:
            raise NotFinite(f"{', '.join(bad)} not finite")
    except NotFinite:
        for buffer, before in statistics:
            buffer.copy_(before)
        raise
    for group in adam.param_groups:
        group["lr"] = rate
    adam.step()
    return values


def _forward(
    model: Network, batch: FaceBatch | MixedBatch, recipe: Recipe
) -> tuple[Tensor, dict[str, Tensor], dict[str, float]]:
    """The loss, all terms to be noted, and how much the answers for labelled faces vary."""
    layout = torch.channels_last if recipe.compute.channels_last else torch.contiguous_format
    image = batch.image.contiguous(memory_format=layout)
    with torch.autocast(image.device.type, torch.bfloat16, enabled=recipe.compute.bfloat16):
        prediction = model(image)
    backend = recipe.compute.loss_backend
    if isinstance(batch, FaceBatch):
        terms = sfsnet_loss(prediction, batch, recipe.loss, backend)
        return terms.total, terms._asdict(), spread_ratios(prediction, batch)
    total, terms, real = mixed_loss(prediction, batch, recipe.loss, recipe.real_loss, backend)
    labelled = Decomposition(*(part[: len(batch.labelled.image)] for part in prediction))
    return total, _named(total, terms, real), spread_ratios(labelled, batch.labelled)


def _named(total: Tensor, labelled: LossTerms, real: LossTerms) -> dict[str, Tensor]:
    values = labelled._asdict() | {"total": total}
    return values | {f"real_{name}": term for name, term in real._asdict().items() if name != "total"}


def _backward(model: nn.Module, total: Tensor, largest: float) -> float:
    total.backward()  # type: ignore[no-untyped-call]
    return float(nn.utils.clip_grad_norm_(model.parameters(), largest))
