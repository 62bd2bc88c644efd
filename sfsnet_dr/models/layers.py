"""Layers of the paper's networks, and batch normalisation shared by processes on any device.

Every convolution carries a bias, as in the authors' release, also where batch normalisation follows and
makes it redundant: parameter counts and layouts then agree with theirs.
"""

from __future__ import annotations

import math
from typing import Any, Final, cast

import torch
import torch.distributed as dist
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
    it is a ``C128(k1)``. It is computed before the interpolation, which takes a quarter of the products: the
    two commute, for the weights of an interpolation add up to 1.
    """

    def __init__(self, features: int, narrow: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(conv_bn_relu(features, features, 1), conv_bn_relu(features, narrow, 3))
        self.out = conv(narrow, 3, 1)

    def forward(self, x: Tensor) -> Tensor:
        mix = cast(nn.Sequential, self.layers[0])
        x = functional.interpolate(mix[0](x), scale_factor=2, mode="bilinear", align_corners=False)
        return to_map(self.layers[1](mix[1:](x)), self.out)


def unit_normal(raw: Tensor) -> Tensor:
    """Raw vectors (B, 3, H, W) to unit vectors; those shorter than ``SHORTEST_NORMAL`` stay short."""
    length = raw.square().sum(1, keepdim=True).clamp_min(SHORTEST_NORMAL**2).sqrt()
    return raw / length


def to_map(features: Tensor, out: nn.Conv2d) -> Tensor:
    """The last convolution of a map, in float32 also under autocast.

    Eight bits of mantissa would step the normals by 0.2 degrees.
    """
    with torch.autocast(features.device.type, enabled=False):
        raw: Tensor = out(features.float())
    return raw


def to_light(features: Tensor, out: nn.Linear) -> Tensor:
    """Means over the pixels of features (B, C, H, W), fully connected to the light, in float32 also under
    autocast."""
    with torch.autocast(features.device.type, enabled=False):
        light: Tensor = out(features.float().mean((2, 3)))
    return light


def initialise_weights(network: nn.Module, slope: float = 0.0) -> None:
    """Convolutions after He et al. 2015, which keeps the variance through (leaky) ReLU layers; biases zero.

    A transposed convolution of stride s adds up inputs k^2 / s^2 numbers for one output.
    """
    for module in network.modules():
        if isinstance(module, nn.ConvTranspose2d):
            terms = module.in_channels * module.kernel_size[0] ** 2 / module.stride[0] ** 2
            nn.init.normal_(module.weight, std=math.sqrt(2 / ((1 + slope**2) * terms)))
        elif isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight, a=slope, nonlinearity="leaky_relu")
        if isinstance(module, nn.Conv2d | nn.ConvTranspose2d) and module.bias is not None:
            nn.init.zeros_(module.bias)


class _Sum(torch.autograd.Function):
    """Sum over all processes; so is the gradient, as the sum of all processes' losses is differentiated."""

    @staticmethod
    def forward(_context: Any, local: Tensor) -> Tensor:
        total = local.clone()
        dist.all_reduce(total)
        return total

    @staticmethod
    def backward(_context: Any, *gradients: Tensor) -> Tensor:
        total = gradients[0].contiguous().clone()
        dist.all_reduce(total)
        return total


class SharedBatchNorm2d(nn.BatchNorm2d):
    """``BatchNorm2d`` over the images of all processes, of which each has as many; float32 inside."""

    def forward(self, input: Tensor) -> Tensor:
        """Normalise (B, C, H, W)."""
        if not self.training:
            return super().forward(input)
        values, size = input.float(), dist.get_world_size()
        mean = _sum(values.mean((0, 2, 3))) / size
        centred = values - mean[:, None, None]
        variance = _sum(centred.square().mean((0, 2, 3))) / size
        self._follow(mean.detach(), variance.detach(), size * values.numel() // values.shape[1])
        scale = self.weight * (variance + self.eps).rsqrt()
        return (centred * scale[:, None, None] + self.bias[:, None, None]).to(input.dtype)

    @torch.no_grad()
    def _follow(self, mean: Tensor, variance: Tensor, count: int) -> None:
        assert self.running_mean is not None
        assert self.running_var is not None
        assert self.num_batches_tracked is not None
        assert self.momentum is not None
        self.num_batches_tracked.add_(1)
        self.running_mean.lerp_(mean, self.momentum)
        self.running_var.lerp_(variance * (count / (count - 1)), self.momentum)


def share_statistics(model: nn.Module) -> None:
    """Make every batch normalisation of a network one over all processes, with the same parameters."""
    for module in model.modules():
        for name, child in module.named_children():
            if type(child) is nn.BatchNorm2d:
                shared = SharedBatchNorm2d(child.num_features, child.eps, child.momentum)
                shared.weight, shared.bias = child.weight, child.bias
                shared.running_mean, shared.running_var = child.running_mean, child.running_var
                shared.num_batches_tracked = child.num_batches_tracked
                shared.train(child.training)
                setattr(module, name, shared)


def _sum(local: Tensor) -> Tensor:
    total: Tensor = _Sum.apply(local)  # type: ignore[no-untyped-call]
    return total
