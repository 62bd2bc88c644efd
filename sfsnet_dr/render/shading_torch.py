"""Order-n Lambertian shading in torch, orders 0 to 4: the twin of the Dr.Jit form, on any device.

Source: Sengupta et al., CVPR 2018, eq. 1 and the appendix on spherical harmonics.
"""

from __future__ import annotations

from functools import reduce
from typing import Final

import torch
from torch import Tensor

from sfsnet_dr.core.conventions import NORMAL_EPSILON
from sfsnet_dr.render.shading_numpy import COLOURS, render_sizes
from sfsnet_dr.sh.basis_torch import sh_basis
from sfsnet_dr.sh.polynomials import MAX_POLYNOMIAL_ORDER

#: Highest SH order of the differentiable forms.
MAX_ORDER: Final = MAX_POLYNOMIAL_ORDER


def unit(normal: Tensor) -> Tensor:
    """Normalise (B, 3, H, W) vectors: n / sqrt(max(|n|^2, 1e-12)), with a finite gradient at n = 0.

    Long vectors are shortened first: |n|^2 overflows in float32 from |n| = 1.8e19 on, and the result would
    be 0 without a word. The direction does not depend on the divisor, which therefore needs no gradient.
    """
    normal = normal / normal.detach().abs().amax(dim=1, keepdim=True).clamp_min(1)
    squared = (normal * normal).sum(dim=1, keepdim=True)
    return normal / torch.sqrt(squared.clamp_min(NORMAL_EPSILON))


def shading(normal: Tensor, light: Tensor) -> Tensor:
    """Shading S = Y(n)^T L of each colour, unclamped; differentiable in both arguments.

    Convention: camera frame; basis order of ``sh.basis``; light 9 R, 9 G, 9 B at order 2.

    Args:
        normal: (B, 3, H, W), any length: they are normalised here.
        light: shading coefficients (B, 3K), K = (order + 1)^2, order 0 to 4. A batch of 1 broadcasts.

    Returns:
        (B, 3, H, W), linear; float64 if an argument is, else float32 (half precision is raised to it).

    Raises:
        InputError: naming the argument whose shape does not fit.
    """
    normal, light = match_shading(normal, light)
    order = render_sizes(normal, light, max_order=MAX_ORDER).order
    basis = sh_basis(unit(normal), order, dim=1)
    coefficients = light.reshape(light.shape[0], COLOURS, (order + 1) ** 2)
    # Under autocast the product would be rounded to half precision, unlike that of the other forms.
    with torch.autocast(normal.device.type, enabled=False):
        return torch.einsum("bkhw,bck->bchw", basis, coefficients)


def f_render(normal: Tensor, albedo: Tensor, light: Tensor) -> Tensor:
    """The paper's f_render: image = albedo * S(normal, light), linear and unclamped.

    Args:
        normal: (B, 3, H, W), any length.
        albedo: (B, 3, H, W), linear.
        light: shading coefficients (B, 3K), order 0 to 4. A batch of 1 broadcasts.

    Returns:
        (B, 3, H, W); float64 if an argument is, else float32. Differentiable in all three arguments.

    Raises:
        InputError: naming the argument whose shape does not fit.
    """
    normal, albedo, light = match(normal, albedo, light)
    return albedo * shading(normal, light)


def match_shading(normal: Tensor, light: Tensor) -> tuple[Tensor, Tensor]:
    """Check shapes; bring both arguments to one batch size and one dtype (views where possible)."""
    batch = render_sizes(normal, light, max_order=MAX_ORDER).batch
    normal, light = _to_common_dtype(normal, light)
    return _to_batch(normal, batch), _to_batch(light, batch)


def match(normal: Tensor, albedo: Tensor, light: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """``match_shading`` for all three arguments of ``f_render``."""
    batch = render_sizes(normal, light, albedo, max_order=MAX_ORDER).batch
    normal, albedo, light = _to_common_dtype(normal, albedo, light)
    return _to_batch(normal, batch), _to_batch(albedo, batch), _to_batch(light, batch)


def _to_common_dtype(*tensors: Tensor) -> list[Tensor]:
    dtype = reduce(torch.promote_types, (t.dtype for t in tensors), torch.float32)
    return [t.to(dtype) for t in tensors]


def _to_batch(tensor: Tensor, batch: int) -> Tensor:
    return tensor if tensor.shape[0] == batch else tensor.expand(batch, *tensor.shape[1:])
