"""One call of a form with its gradients, as bits that processes and threads can be compared by."""

from __future__ import annotations

import hashlib

import numpy as np
import torch
from torch import Tensor

from sfsnet_dr.experiments.stability.backends import DIFFERENTIABLE, Form, Inputs, form_named
from sfsnet_dr.experiments.stability.cases import ordinary


def inputs(seed: int, batch: int, height: int, width: int) -> Inputs:
    """Ordinary float32 inputs of which normal, albedo and light get gradients."""
    made = ordinary(np.random.default_rng(seed), batch, height, width)
    return Inputs(
        **{
            name: torch.tensor(values, dtype=torch.float32).requires_grad_(name in DIFFERENTIABLE)
            for name, values in made.items()
        }
    )


def forward(form: Form, arguments: Inputs) -> Tensor:
    """The value, reduced to a scalar for ``backward``."""
    with form.flags():
        return form.call(arguments).square().sum()


def backward(form: Form, total: Tensor, arguments: Inputs) -> list[Tensor]:
    """Gradients of ``forward``'s result; none of a form that has none."""
    if not form.differentiable:
        return []
    with form.flags():
        return list(torch.autograd.grad(total, arguments[:3]))


def numbers(form: Form, arguments: Inputs) -> list[Tensor]:
    """``forward`` and its ``backward``."""
    total = forward(form, arguments)
    return [total.detach(), *backward(form, total, arguments)]


def digest(form: Form, arguments: Inputs) -> str:
    """A name for all bits of value and gradients."""
    return bits(*numbers(form, arguments))


def bits(*tensors: Tensor) -> str:
    """A name for the bits of tensors."""
    found = hashlib.sha256()
    for tensor in tensors:
        found.update(np.ascontiguousarray(tensor.detach().numpy()).tobytes())
    return found.hexdigest()


def digest_of(name: str, seed: int = 0, size: int = 256) -> str:
    """``digest`` by names alone, for another process; large enough to be shared by threads."""
    return digest(form_named(name), inputs(seed, 2, size, size))
