"""What a decomposition network gives back."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class Decomposition(NamedTuple):
    """Normals, albedo and light behind a batch of images, float32.

    Args:
        normal: unit vectors in the camera frame (x right, y up, z toward the viewer), (B, 3, H, W).
        albedo: linear Rec. 709 reflectance as the network gave it, not clamped, (B, 3, H, W).
        light: order-2 shading coefficients L = A_l l / pi, 9 R, 9 G, 9 B, (B, 27).
    """

    normal: Tensor
    albedo: Tensor
    light: Tensor
