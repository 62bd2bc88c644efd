"""The reconstruction loss in torch: the twin that the Dr.Jit kernel is held against."""

from __future__ import annotations

from torch import Tensor

from sfsnet_dr.render.shading_torch import f_render


def masked_l1_sum(normal: Tensor, albedo: Tensor, light: Tensor, image: Tensor, mask: Tensor) -> Tensor:
    """Sum of mask |image - f_render| over images, colours and pixels; shapes as ``reconstruction_l1``."""
    return (mask * (image - f_render(normal, albedo, light)).abs()).sum()
