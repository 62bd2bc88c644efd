"""One call of a form with its gradients, as bits that processes and threads can be compared by."""

from __future__ import annotations

import hashlib

import numpy as np
import torch
from torch import Tensor

from sfsnet_dr.experiments.stability.backends import DIFFERENTIABLE, ComputeBackend, Inputs, find_backend
from sfsnet_dr.experiments.stability.cases import default_case


def make_inputs(seed: int, batch: int, height: int, width: int) -> Inputs:
    """Ordinary float32 inputs of which normal, albedo and light get gradients."""
    made = default_case(np.random.default_rng(seed), batch, height, width)
    return Inputs(
        **{
            name: torch.tensor(values, dtype=torch.float32).requires_grad_(name in DIFFERENTIABLE)
            for name, values in made.items()
        }
    )


def run_forward(form: ComputeBackend, arguments: Inputs) -> Tensor:
    """The value, reduced to a scalar for ``run_backward``."""
    with form.flags():
        return form.call(arguments).square().sum()


def run_backward(form: ComputeBackend, total: Tensor, arguments: Inputs) -> list[Tensor]:
    """Gradients of ``run_forward``'s result; none of a form that has none."""
    if not form.differentiable:
        return []
    with form.flags():
        return list(torch.autograd.grad(total, arguments[:3]))


def flatten_results(form: ComputeBackend, arguments: Inputs) -> list[Tensor]:
    """``run_forward`` and its ``run_backward``."""
    total = run_forward(form, arguments)
    return [total.detach(), *run_backward(form, total, arguments)]


def result_digest(form: ComputeBackend, arguments: Inputs) -> str:
    """A name for all bits of value and gradients."""
    return float_bits(*flatten_results(form, arguments))


def float_bits(*tensors: Tensor) -> str:
    """A name for the bits of tensors."""
    found = hashlib.sha256()
    for tensor in tensors:
        found.update(np.ascontiguousarray(tensor.detach().numpy()).tobytes())
    return found.hexdigest()


def digest_of(name: str, seed: int = 0, size: int = 256) -> str:
    """``result_digest`` by names alone, for another process; large enough to be shared by threads."""
    return result_digest(find_backend(name), make_inputs(seed, 2, size, size))
