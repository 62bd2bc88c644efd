"""An early word when a network's albedo or normals lose their variation over the face.

The paper names such trivial solutions as what training by reconstruction alone ends in: constant albedo and
everything in the shading, or flat normals and everything in the albedo. Reconstruction errors do not show it.
"""

from __future__ import annotations

from typing import Final

from torch import Tensor

from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.model.outputs import Decomposition

#: A part has collapsed when it keeps less than this share of its labels' spread, on average ...
SMALLEST: Final = 0.15
#: ... that is an exponential mean over about this many steps, which are also waited for at first.
STEPS: Final = 50

PARTS: Final = ("normal", "albedo")


def spread_ratios(prediction: Decomposition, target: FaceBatch) -> dict[str, float]:
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


class Watch:
    """Follows the ratios of a run, and warns once for each part that collapses."""

    def __init__(self) -> None:
        self.means: dict[str, float] = {}
        self.seen = 0
        self.told: set[str] = set()

    def see(self, ratios: dict[str, float]) -> str:
        """Take the ratios of a step; a warning if a part has just collapsed, else nothing."""
        self.seen += 1
        for name, ratio in ratios.items():
            share = max(1 / self.seen, 1 / STEPS)
            self.means[name] = (1 - share) * self.means.get(name, 0.0) + share * ratio
        if self.seen < STEPS:
            return ""
        fallen = [n for n in PARTS if self.means.get(n, 1.0) < SMALLEST and n not in self.told]
        self.told.update(fallen)
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
