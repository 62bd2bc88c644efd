"""The base class of decomposition networks, and their output."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, NamedTuple

from torch import Tensor, nn

from sfsnet_dr.core.errors import InputError, check_shape


class NetworkOutput(NamedTuple):
    """Normals, albedo and light behind a batch of images, float32.

    Args:
        normal: unit vectors in the camera frame (x right, y up, z toward the viewer), (B, 3, H, W).
        albedo: linear Rec. 709 reflectance as the network gave it, not clamped, (B, 3, H, W).
        light: order-2 shading coefficients L = A_l l / pi, 9 R, 9 G, 9 B, (B, 27).
    """

    normal: Tensor
    albedo: Tensor
    light: Tensor


class Network(nn.Module):
    """A module from images to a ``NetworkOutput`` that can be made again by name and settings.

    Attributes:
        architecture: its name in recipes and weights files.
        multiple: height and width of its images are multiples of this.
        config: the constructor's arguments.

    Raises:
        InputError: for a setting below 1.
    """

    architecture: ClassVar[str]
    multiple: ClassVar[int]

    def __init__(self, config: Mapping[str, int]) -> None:
        super().__init__()
        self.config = dict(config)
        for name, value in config.items():
            if value < 1:
                raise InputError(f"{name}: {value} found, at least 1 is needed for a {self.architecture}")

    def forward(self, image: Tensor) -> NetworkOutput:
        """Decompose images (B, 3, H, W): linear Rec. 709, or encoded where it was trained on such.

        Raises:
            InputError: for another rank, channel count or size.
        """
        raise NotImplementedError

    def check(self, image: Tensor) -> None:
        """Refuse images that this network cannot take."""
        sizes = check_shape("image", image, "B 3 H W")
        if sizes["H"] % self.multiple or sizes["W"] % self.multiple:
            raise InputError(
                f"image: {sizes['H']} x {sizes['W']} pixels found, multiples of {self.multiple} are needed"
            )
