"""SfSNet: one face image to normals, albedo and light (Sengupta et al., CVPR 2018, appendix 7.1)."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn

from sfsnet_dr.core.conventions import LIGHT_SIZE
from sfsnet_dr.models.base import Network, NetworkOutput
from sfsnet_dr.models.layers import (
    MapHead,
    conv,
    conv_bn_relu,
    initialise_weights,
    residual_stage,
    to_light,
    unit_normal,
)


class SfSNet(Network):
    """The network of the paper's appendix; the defaults are its widths and depth (3,423,393 parameters).

    Input is a linear Rec. 709 image (B, 3, H, W), exposed so that white paper facing the light is near 1;
    H and W are even, 128 in the paper.

    Departures, each equal in what can be expressed: the normal head's raw output is the vector itself and
    not (n + 1) / 2, an affine map which its last layer absorbs; input is linear and RGB, where the release
    takes display-referred BGR; light is in shading coefficients, the release's are in units of its own.

    Args:
        stem: channels of the first convolution and of the heads' last hidden layer.
        features: channels of everything between.
        blocks: residual blocks in each of the two branches.
    """

    architecture: ClassVar[str] = "sfsnet"
    multiple: ClassVar[int] = 2

    def __init__(self, stem: int = 64, features: int = 128, blocks: int = 5) -> None:
        super().__init__({"stem": stem, "features": features, "blocks": blocks})
        self.conv = nn.Sequential(
            conv_bn_relu(3, stem, 7), conv_bn_relu(stem, features, 3), conv(features, features, 3, stride=2)
        )
        self.normal_blocks = residual_stage(features, blocks)
        self.albedo_blocks = residual_stage(features, blocks)
        self.normal_head = MapHead(features, stem)
        self.albedo_head = MapHead(features, stem)
        self.light_features = conv_bn_relu(3 * features, features, 1)
        self.light_out = nn.Linear(features, LIGHT_SIZE)
        initialise_weights(self)

    def forward(self, image: Tensor) -> NetworkOutput:
        """See ``Network``; sizes are even."""
        self.check(image)
        features = self.conv(image)
        normal_features = self.normal_blocks(features)
        albedo_features = self.albedo_blocks(features)
        return NetworkOutput(
            normal=unit_normal(self.normal_head(normal_features)),
            albedo=self.albedo_head(albedo_features),
            light=self._light(features, normal_features, albedo_features),
        )

    def _light(self, image: Tensor, normal: Tensor, albedo: Tensor) -> Tensor:
        # The text lists image, normal, albedo; the release concatenates normal, albedo, image. The order
        # only names the input channels of the 1 x 1 convolution; the release's is kept.
        return to_light(self.light_features(torch.cat((normal, albedo, image), dim=1)), self.light_out)
