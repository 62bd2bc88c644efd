"""What every decomposition network has in common."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from torch import Tensor, nn

from sfsnet_dr.base.checks import BadInput, check_shape
from sfsnet_dr.model.outputs import Decomposition


class Network(nn.Module):
    """A module from images to a ``Decomposition`` that can be made again by name and settings.

    Attributes:
        architecture: its name in recipes and weights files.
        multiple: height and width of its images are multiples of this.
        config: the constructor's arguments.

    Raises:
        BadInput: for a setting below 1.
    """

    architecture: ClassVar[str]
    multiple: ClassVar[int]

    def __init__(self, config: Mapping[str, int]) -> None:
        super().__init__()
        self.config = dict(config)
        for name, value in config.items():
            if value < 1:
                raise BadInput(f"{name}: {value} found, at least 1 is needed for a {self.architecture}")

    def forward(self, image: Tensor) -> Decomposition:
        """Decompose images (B, 3, H, W): linear Rec. 709, or encoded where it was trained on such.

        Raises:
            BadInput: for another rank, channel count or size.
        """
        raise NotImplementedError

    def check(self, image: Tensor) -> None:
        """Refuse images that this network cannot take."""
        sizes = check_shape("image", image, "B 3 H W")
        if sizes["H"] % self.multiple or sizes["W"] % self.multiple:
            raise BadInput(
                f"image: {sizes['H']} x {sizes['W']} pixels found, multiples of {self.multiple} are needed"
            )
