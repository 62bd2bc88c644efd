"""Layers that the networks of the paper's appendix are made of.

Every convolution carries a bias, as in the authors' release, also where batch normalisation follows and
makes it redundant: parameter counts and layouts then agree with theirs.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

#: Length below which a raw normal is divided by this number instead of by its length, which bounds the
#: gradient of the normalisation by its inverse (the release's ``|n| + 1e-8`` does not).
SHORTEST_NORMAL: Final = 1e-2


def conv(inputs: int, outputs: int, kernel: int, stride: int = 1) -> nn.Conv2d:
    """``C*N(kS)`` of the appendix: a bare convolution with the padding that keeps H / stride."""
    return nn.Conv2d(inputs, outputs, kernel, stride, padding=kernel // 2)


def conv_bn_relu(inputs: int, outputs: int, kernel: int) -> nn.Sequential:
    """``CN(kS)`` of the appendix: convolution of stride 1, batch normalisation, ReLU."""
    return nn.Sequential(conv(inputs, outputs, kernel), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


class ResidualBlock(nn.Module):
    """``ResBLK`` of the appendix: x + (BN - ReLU - C(k3) - BN - ReLU - C(k3))(x), after He et al. 2016b."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.BatchNorm2d(features),
            nn.ReLU(inplace=True),
            conv(features, features, 3),
            nn.BatchNorm2d(features),
            nn.ReLU(inplace=True),
            conv(features, features, 3),
        )

    def forward(self, x: Tensor) -> Tensor:
        result: Tensor = x + self.layers(x)
        return result


def residual_stage(features: int, blocks: int) -> nn.Sequential:
    """``n ResBLK - BN - ReLU``, at constant width and resolution."""
    stage = [ResidualBlock(features) for _ in range(blocks)]
    return nn.Sequential(*stage, nn.BatchNorm2d(features), nn.ReLU(inplace=True))


class MapHead(nn.Module):
    """``BU - C(k1) - C64(k3) - C*3(k1)``: features (B, C, H, W) to a raw map (B, 3, 2H, 2W), float32.

    The appendix writes ``CD128(k1)`` for the first convolution without saying what D is; as in the release
    it is a ``C128(k1)``. The last layer runs in float32 also under autocast: eight bits of mantissa would
    step the normals by .2 degrees.
    """

    def __init__(self, features: int, narrow: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(conv_bn_relu(features, features, 1), conv_bn_relu(features, narrow, 3))
        self.out = conv(narrow, 3, 1)

    def forward(self, x: Tensor) -> Tensor:
        x = functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
        x = self.layers(x)
        with torch.autocast(x.device.type, enabled=False):
            raw: Tensor = self.out(x.float())
        return raw


def unit_normal(raw: Tensor) -> Tensor:
    """Raw vectors (B, 3, H, W) to unit vectors; those shorter than ``SHORTEST_NORMAL`` stay short."""
    length = raw.square().sum(1, keepdim=True).clamp_min(SHORTEST_NORMAL**2).sqrt()
    return raw / length


def initialise(network: nn.Module) -> None:
    """Convolutions after He et al. 2015, which keeps the variance through ReLU layers; biases zero."""
    for module in network.modules():
        if isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
            if module.bias is not None:
                nn.init.zeros_(module.bias)
