"""Gradients of f_render: finite differences of the float64 oracle, then torch against Dr.Jit in float32."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import Tensor

from sfsnet_dr.render import shading_drjit, shading_numpy, shading_torch

Array = npt.NDArray[np.float64]
NAMES = ("normal", "albedo", "light")


def central_differences(function: Callable[[list[Array]], float], inputs: list[Array]) -> list[Array]:
    """Numerical gradient, entry by entry, with a step of 1e-5 of each array's largest entry."""
    grads = []
    for values in inputs:
        grad, step = np.zeros_like(values), 1e-5 * np.abs(values).max()
        for at in np.ndindex(values.shape):
            kept = values[at]
            ends = []
            for end in (kept + step, kept - step):
                values[at] = end
                ends.append(function(inputs))
            values[at] = kept
            grad[at] = (ends[0] - ends[1]) / (2 * step)
        grads.append(grad)
    return grads


def scene(order: int, seed: int, batches: tuple[int, int, int] = (2, 2, 2)) -> list[Array]:
    """Normals of lengths 0.3 to 2, albedo and light, float64."""
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((batches[0], 3, 3, 4))
    normal *= rng.uniform(0.3, 2, (batches[0], 1, 3, 4)) / np.linalg.norm(normal, axis=1, keepdims=True)
    albedo = rng.uniform(0.1, 1, (batches[1], 3, 3, 4))
    return [normal, albedo, rng.standard_normal((batches[2], 3 * (order + 1) ** 2))]


def gradients(
    render: Callable[..., Tensor], inputs: list[Array], weight: Array, dtype: torch.dtype
) -> list[Array]:
    tensors = [torch.tensor(a, dtype=dtype, requires_grad=True) for a in inputs]
    torch.autograd.backward((render(*tensors) * torch.tensor(weight, dtype=dtype)).sum())
    # Order 0 does not depend on normals: torch then leaves their gradient out.
    return [np.zeros(t.shape) if t.grad is None else t.grad.double().numpy() for t in tensors]


def worst(found: list[Array], expected: list[Array]) -> float:
    """Largest difference of any entry, relative to the largest entry of its own array."""
    pairs = zip(found, expected, strict=True)
    return max(float(np.abs(f - e).max() / max(np.abs(e).max(), 1e-3)) for f, e in pairs)


@pytest.mark.parametrize("module", [shading_torch, shading_drjit], ids=["torch", "drjit"])
@pytest.mark.parametrize("order", range(5))
def test_equals_finite_differences_of_the_oracle(module: Any, order: int) -> None:
    inputs = scene(order, seed=order)
    weight = np.random.default_rng(9).standard_normal((2, 3, 3, 4))
    expected = central_differences(lambda a: float((shading_numpy.f_render(*a) * weight).sum()), inputs)
    # Worst of 50 scenes 9e-9, from the step of the finite differences at the shortest normals.
    assert worst(gradients(module.f_render, inputs, weight, torch.float64), expected) < 3e-8
    # Worst of 50 scenes 8e-7, float32 round-off.
    assert worst(gradients(module.f_render, inputs, weight, torch.float32), expected) < 4e-6


@pytest.mark.parametrize("module", [shading_torch, shading_drjit], ids=["torch", "drjit"])
@pytest.mark.parametrize("batches", [(1, 3, 3), (3, 1, 3), (3, 3, 1), (1, 1, 3)])
def test_broadcast_inputs_collect_the_whole_batch(module: Any, batches: tuple[int, int, int]) -> None:
    inputs = scene(2, seed=3, batches=batches)
    weight = np.random.default_rng(9).standard_normal((3, 3, 3, 4))
    expected = central_differences(lambda a: float((shading_numpy.f_render(*a) * weight).sum()), inputs)
    assert worst(gradients(module.f_render, inputs, weight, torch.float64), expected) < 3e-8


@pytest.mark.parametrize("module", [shading_torch, shading_drjit], ids=["torch", "drjit"])
def test_gradient_of_shading_alone(module: Any) -> None:
    normal, _, light = scene(2, seed=4)
    weight = np.random.default_rng(9).standard_normal((2, 3, 3, 4))
    expected = central_differences(
        lambda a: float((shading_numpy.shading(*a) * weight).sum()), [normal, light]
    )
    assert worst(gradients(module.shading, [normal, light], weight, torch.float64), expected) < 3e-8


@pytest.mark.parametrize("seed", range(4))
def test_drjit_equals_torch_in_float32_at_working_size(seed: int) -> None:
    """A sum over 128 x 128 pixels is what the light's gradient is in training."""
    rng = torch.Generator().manual_seed(seed)
    inputs = [torch.randn(2, 3, 128, 128, generator=rng), torch.rand(2, 3, 128, 128, generator=rng)]
    arrays = [t.double().numpy() for t in (*inputs, torch.randn(2, 27, generator=rng))]
    weight = torch.randn(2, 3, 128, 128, generator=rng).double().numpy()
    exact = gradients(shading_torch.f_render, arrays, weight, torch.float64)
    torch32 = gradients(shading_torch.f_render, arrays, weight, torch.float32)
    drjit32 = gradients(shading_drjit.f_render, arrays, weight, torch.float32)
    # Worst over 20 seeds: 9e-7, 1.8e-6 and 1.6e-6, always in the light, whose 16,384 terms of either sign
    # nearly cancel; 4.3e-7 in normals and albedo. Margin 3.
    assert worst(torch32, exact) < 5e-6
    assert worst(drjit32, exact) < 5e-6
    assert worst(drjit32, torch32) < 5e-6
    assert worst(drjit32[:2], torch32[:2]) < 1.5e-6


@pytest.mark.parametrize("length", [0.0, 1e-9, 5e-7, 2e-6, 1e-4])
def test_gradients_near_zero_normals_are_finite_and_agree(length: float) -> None:
    """Below the floor of 1e-6 the gradient of n / 1e-6 stays bounded by 1e6 times the basis' slope."""
    inputs = scene(4, seed=5)
    inputs[0] *= length / np.linalg.norm(inputs[0], axis=1, keepdims=True)
    weight = np.random.default_rng(9).standard_normal((2, 3, 3, 4))
    twin = gradients(shading_torch.f_render, inputs, weight, torch.float64)
    found = gradients(shading_drjit.f_render, inputs, weight, torch.float64)
    assert all(np.isfinite(g).all() for g in (*twin, *found))
    assert worst(found, twin) < 1e-12
