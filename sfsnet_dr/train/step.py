"""One optimiser step, which refuses numbers that are not finite, and the collapse monitor.

The paper names such trivial solutions as what training by reconstruction alone ends in: constant albedo and
everything in the shading, or flat normals and everything in the albedo. Reconstruction errors do not show it.
"""

from __future__ import annotations

import math
from typing import Final

import torch
from torch import Tensor, nn

from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.mixed_batch import MixedBatch
from sfsnet_dr.losses.sfsnet import BatchShare, LossTerms, mixed_loss, sfsnet_loss
from sfsnet_dr.models.base import Network, NetworkOutput
from sfsnet_dr.train.config import Recipe
from sfsnet_dr.train.distributed import ProcessGroup

#: A part has collapsed when it keeps less than this share of its labels' spread, on average ...
SMALLEST: Final = 0.15
#: ... that is an exponential mean over about this many steps, which are also waited for at first.
STEPS: Final = 50

PARTS: Final = ("normal", "albedo")


def spread_ratios(prediction: NetworkOutput, target: FaceBatch) -> dict[str, float]:
    """For normals and albedo, the standard deviation over each face as a share of that of its labels.

    A deviation is the root of the variance over the mask's pixels, summed over the three channels; the share
    is that of the sums over the batch. 1 for perfect answers, 0 for answers without variation.
    """
    pairs = {
        "normal": (prediction.normal, target.normal),
        "albedo": (prediction.albedo, target.albedo),
    }
    return {
        name: _spread(a, target.mask) / max(_spread(b, target.mask), 1e-6) for name, (a, b) in pairs.items()
    }


class CollapseMonitor:
    """Follows the ratios of a run, and warns once for each part that collapses."""

    def __init__(self) -> None:
        self.means: dict[str, float] = {}
        self.seen = 0
        self.reported: set[str] = set()

    def see(self, ratios: dict[str, float]) -> str:
        """Take the ratios of a step; a warning if a part has just collapsed, else nothing."""
        self.seen += 1
        for name, ratio in ratios.items():
            share = max(1 / self.seen, 1 / STEPS)
            self.means[name] = (1 - share) * self.means.get(name, 0.0) + share * ratio
        if self.seen < STEPS:
            return ""
        fallen = [n for n in PARTS if self.means.get(n, 1.0) < SMALLEST and n not in self.reported]
        self.reported.update(fallen)
        return "; ".join(self._warning(name) for name in fallen)

    def _warning(self, name: str) -> str:
        share, limit = 100 * self.means[name], 100 * SMALLEST
        return (
            f"{name} has collapsed: its variation over a face is {share:.0f} % of its labels' (warned below "
            f"{limit:.0f} %); give loss.{name} more weight"
        )


def _spread(values: Tensor, mask: Tensor) -> float:
    values, weight = values.detach().float(), mask.float()
    count = weight.sum((2, 3), keepdim=True).clamp_min(1)
    mean = (weight * values).sum((2, 3), keepdim=True) / count
    variance = (weight * (values - mean).square()).sum((2, 3), keepdim=True) / count
    return float(variance.sum(1).sqrt().sum())


_ALONE: Final = ProcessGroup()


class NonFiniteError(Exception):
    """A batch gave NaN or infinity; the network and its optimiser are as they were before it."""


def training_step(
    model: Network,
    adam: torch.optim.Adam,
    batch: FaceBatch | MixedBatch,
    recipe: Recipe,
    rate: float,
    team: ProcessGroup = _ALONE,
) -> dict[str, float]:
    """Learn from one batch.

    Args:
        model: in training mode.
        adam: its optimiser.
        batch: in float32, contiguous; this process's part of it where several train together.
        recipe: precision, memory order, loss and largest gradient are taken from it.
        rate: learning rate of this step.
        team: the processes that train together; all of them call this with parts of one batch.

    Returns:
        The loss and its terms before the step; of a mixed batch those of the labelled faces, and those of the
        real ones as ``real_recon`` and so on. ``gradient`` is the norm of the gradient before clipping,
        ``normal_spread`` and ``albedo_spread`` are the ratios of ``fit.collapse``, their means over the
        processes.

    Raises:
        NotFinite: if the loss or the gradient is not finite; nothing has been changed then, batch
            normalisation's running statistics included.
    """
    statistics = [(buffer, buffer.clone()) for buffer in model.buffers()]
    try:
        total, terms, ratios = _forward(model, batch, recipe, team)
        adam.zero_grad(set_to_none=True)
        total.backward()  # type: ignore[no-untyped-call]
        team.sum_gradients(model)
        norm = nn.utils.clip_grad_norm_(model.parameters(), recipe.optimiser.max_grad_norm)
        shares = {f"{name}_spread": total.new_tensor(r / team.size) for name, r in ratios.items()}
        names = [*terms, *shares]
        sums = team.sum(torch.stack([*terms.values(), *shares.values()]).detach())
        numbers = torch.cat([sums, norm.reshape(1)]).tolist()  # waits for a GPU once
        values = dict(zip([*names, "gradient"], numbers, strict=True))
        bad = [name for name, value in values.items() if not math.isfinite(value)]
        if bad:
            raise NonFiniteError(f"{', '.join(bad)} not finite")
    except NonFiniteError:
        for buffer, before in statistics:
            buffer.copy_(before)
        raise
    for group in adam.param_groups:
        group["lr"] = rate
    adam.step()
    return values


def predict_encoded(model: Network, image: Tensor, recipe: Recipe) -> NetworkOutput:
    """A network's answer in the recipe's precision and memory order."""
    layout = torch.channels_last if recipe.compute.channels_last else torch.contiguous_format
    image = image.contiguous(memory_format=layout)
    with torch.autocast(image.device.type, torch.bfloat16, enabled=recipe.compute.bfloat16(image.device)):
        answer: NetworkOutput = model(image)
    return answer


def batch_loss(
    prediction: NetworkOutput, batch: FaceBatch | MixedBatch, recipe: Recipe, team: ProcessGroup = _ALONE
) -> tuple[Tensor, dict[str, Tensor]]:
    """The loss of a batch, and all terms to be noted; their sums over a team are those of the whole batch."""
    backend = recipe.compute.loss_backend
    if isinstance(batch, FaceBatch):
        terms = sfsnet_loss(prediction, batch, recipe.loss, backend, share=_share(batch, team))
        return terms.total, terms._asdict()
    shares = [_share(part, team) for part in (batch.labelled, batch.real.faces)]
    both = None if shares[0] is None or shares[1] is None else (shares[0], shares[1])
    total, terms, real = mixed_loss(prediction, batch, recipe.loss, recipe.real_loss, backend, both)
    return total, _named(total, terms, real)


def _forward(
    model: Network, batch: FaceBatch | MixedBatch, recipe: Recipe, team: ProcessGroup
) -> tuple[Tensor, dict[str, Tensor], dict[str, float]]:
    """The loss, all terms to be noted, and how much the answers for labelled faces vary."""
    prediction = predict_encoded(model, batch.image, recipe)
    total, terms = batch_loss(prediction, batch, recipe, team)
    labelled = batch if isinstance(batch, FaceBatch) else batch.labelled
    first = NetworkOutput(*(part[: len(labelled.image)] for part in prediction))
    return total, terms, spread_ratios(first, labelled)


def _share(batch: FaceBatch, team: ProcessGroup) -> BatchShare | None:
    if team.size == 1:
        return None
    own = batch.mask.sum()
    return BatchShare(own / team.sum(own).clamp_min(1e-6), 1 / team.size)


def _named(total: Tensor, labelled: LossTerms, real: LossTerms) -> dict[str, Tensor]:
    values = labelled._asdict() | {"total": total}
    return values | {f"real_{name}": term for name, term in real._asdict().items() if name != "total"}
