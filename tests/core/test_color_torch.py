from __future__ import annotations

import numpy as np
import pytest
import torch

from sfsnet_dr.core import color, color_torch

VALUES = torch.cat(
    [torch.linspace(-0.5, 2, 501, dtype=torch.float64), torch.tensor([0.0031308, 0.04045, 0.0])]
)


@pytest.mark.parametrize("name", ["srgb_to_linear", "linear_to_srgb"])
def test_twin_of_colour_science(name: str) -> None:
    expected = getattr(color, name)(VALUES.numpy())
    # Near the joint either piece may be taken, because colour-science rounds the threshold its own way.
    np.testing.assert_allclose(getattr(color_torch, name)(VALUES).numpy(), expected, rtol=1e-12, atol=1e-7)


@pytest.mark.parametrize("name", ["srgb_to_linear", "linear_to_srgb"])
def test_gradient_by_finite_differences(name: str) -> None:
    inputs = torch.tensor([-0.3, 0.0, 0.001, 0.02, 0.2, 1.0, 1.7], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(getattr(color_torch, name), inputs)


@pytest.mark.parametrize("name", ["srgb_to_linear", "linear_to_srgb"])
def test_gradient_is_finite_everywhere(name: str) -> None:
    inputs = VALUES.clone().float().requires_grad_()
    getattr(color_torch, name)(inputs).sum().backward()
    assert inputs.grad is not None
    assert torch.isfinite(inputs.grad).all()
    assert (inputs.grad > 0).all()
