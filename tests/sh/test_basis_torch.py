from __future__ import annotations

import pytest
import torch

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.sh.basis import sh_basis as sh_basis_numpy
from sfsnet_dr.sh.basis_torch import sh_basis


def unit_directions(count: int = 200) -> torch.Tensor:
    generator = torch.Generator().manual_seed(3)
    return torch.nn.functional.normalize(
        torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=1
    )


@pytest.mark.parametrize("order", range(5))
def test_polynomials_are_the_recurrence(order: int) -> None:
    d = unit_directions()
    expected = torch.from_numpy(sh_basis_numpy(d.numpy(), order))
    torch.testing.assert_close(sh_basis(d, order), expected, rtol=0, atol=1e-14)  # 6e-16 seen


def test_channels_first() -> None:
    d = unit_directions(24).reshape(2, 3, 4, 3)
    by_channel = sh_basis(d.permute(0, 3, 1, 2), 4, dim=1)
    assert by_channel.shape == (2, 25, 3, 4)
    torch.testing.assert_close(by_channel.permute(0, 2, 3, 1), sh_basis(d, 4), rtol=0, atol=0)


def test_gradients() -> None:
    d = unit_directions(4).requires_grad_()
    assert torch.autograd.gradcheck(lambda v: sh_basis(v, 4), d)


def test_keeps_dtype() -> None:
    assert sh_basis(unit_directions().float(), 2).dtype == torch.float32


def test_bad_input() -> None:
    with pytest.raises(InputError, match="order: 5 found, 0 to 4 allowed"):
        sh_basis(unit_directions(), 5)
    with pytest.raises(InputError, match="3 components in dimension 1 expected"):
        sh_basis(torch.zeros(2, 4, 5, 5), 2, dim=1)
