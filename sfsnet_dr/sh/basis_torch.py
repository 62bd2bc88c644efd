"""Real spherical harmonics in torch, differentiable; conventions as in ``sfsnet_dr.sh.basis``."""

from __future__ import annotations

import torch
from torch import Tensor

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.sh.polynomials import sh_polynomials


def sh_basis(directions: Tensor, order: int, dim: int = -1) -> Tensor:
    """Evaluate all basis functions up to an order.

    Args:
        directions: unit vectors, x, y, z along dimension ``dim``: (..., 3), or (B, 3, H, W) with
            ``dim=1``. They are not normalised here.
        order: 0 to 4.
        dim: the dimension that holds x, y, z.

    Returns:
        The same shape with K = (order + 1)^2 in place of 3; dtype and device of ``directions``.

    Raises:
        InputError: if dimension ``dim`` does not hold 3 components or the order is out of range.
    """
    if directions.ndim == 0 or directions.shape[dim] != 3:
        raise InputError(
            f"directions: shape {tuple(directions.shape)} found, 3 components in dimension {dim} expected"
        )
    x, y, z = directions.unbind(dim)
    constant, *rest = sh_polynomials(x, y, z, order)
    return torch.stack([torch.full_like(z, constant), *rest], dim=dim)
