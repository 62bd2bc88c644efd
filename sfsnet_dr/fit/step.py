"""One optimiser step, and the refusal of one whose numbers are not finite."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.fit.recipe import Recipe
from sfsnet_dr.loss.terms import LossTerms, sfsnet_loss
from sfsnet_dr.model.sfsnet import SfSNet


class NotFinite(Exception):
    """A batch gave NaN or infinity; the network and its optimiser are as they were before it."""


def training_step(
    model: SfSNet, adam: torch.optim.Adam, batch: FaceBatch, recipe: Recipe, rate: float
) -> dict[str, float]:
    """Learn from one batch.

    Args:
        model: in training mode.
        adam: its optimiser.
        batch: in float32, contiguous.
        recipe: precision, memory order, loss and largest gradient are taken from it.
        rate: learning rate of this step.

    Returns:
        The loss and its terms before the step, and ``gradient``, the norm of the gradient before clipping.

    Raises:
        NotFinite: if the loss or the gradient is not finite; nothing has been changed then, batch
            normalisation's running statistics included.
    """
    statistics = [(buffer, buffer.clone()) for buffer in model.buffers()]
    try:
        terms = _forward(model, batch, recipe)
        values = {name: float(term.detach()) for name, term in terms._asdict().items()}
        adam.zero_grad(set_to_none=True)
        values["gradient"] = _backward(model, terms.total, recipe.optimiser.largest_gradient)
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


def _forward(model: SfSNet, batch: FaceBatch, recipe: Recipe) -> LossTerms:
    layout = torch.channels_last if recipe.compute.channels_last else torch.contiguous_format
    image = batch.image.contiguous(memory_format=layout)
    with torch.autocast(image.device.type, torch.bfloat16, enabled=recipe.compute.bfloat16):
        prediction = model(image)
    return sfsnet_loss(prediction, batch, recipe.loss, recipe.compute.loss_backend)


def _backward(model: nn.Module, total: Tensor, largest: float) -> float:
    total.backward()  # type: ignore[no-untyped-call]
    return float(nn.utils.clip_grad_norm_(model.parameters(), largest))
