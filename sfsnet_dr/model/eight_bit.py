"""Weights in eight bits, so that three networks fit into one package.

Every tensor of two dimensions and more becomes int8 with one float16 step for each index of its first axis.
The largest magnitude there is 127 steps, so a weight is wrong by half a step at most, .4 % of the largest
beside it. Biases, batch normalisation and its statistics are small and stay as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import torch
from torch import Tensor

#: Ends the names of the steps, which stand beside the tensors that they belong to.
STEP: Final = ":step"

_LARGEST: Final = 127


def to_eight_bit(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Tensors as they are kept, the steps among them."""
    kept: dict[str, Tensor] = {}
    for name, tensor in tensors.items():
        if tensor.ndim < 2 or not tensor.is_floating_point():
            kept[name] = tensor
            continue
        largest = tensor.abs().flatten(1).amax(1)
        # Rounded up to half precision, so that no weight needs more than 127 steps.
        step = torch.nextafter((largest / _LARGEST).half(), torch.tensor(torch.inf, dtype=torch.float16))
        kept[name] = (tensor / _beside(step, tensor)).round().to(torch.int8)
        kept[name + STEP] = step
    return kept


def from_eight_bit(kept: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Float32 tensors of what ``to_eight_bit`` gave; what has no step stays as it is."""
    return {
        name: tensor.float() * _beside(kept[name + STEP], tensor) if name + STEP in kept else tensor
        for name, tensor in kept.items()
        if not name.endswith(STEP)
    }


def _beside(step: Tensor, tensor: Tensor) -> Tensor:
    return step.float().reshape(-1, *(1,) * (tensor.ndim - 1))
