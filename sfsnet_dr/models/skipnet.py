"""SkipNet and SkipNet+, the paper's encoder-decoders (Sengupta et al., CVPR 2018, appendix 7.2 and 7.3).

What the text leaves open, and how it is read here:

- Skip connections are concatenations, as in Isola et al. 2017, to which it refers. It names the layers that
  they connect for SkipNet+: the five ``CN(k3)`` of stride 2 and the five ``CDN(k4)``. So the response of each
  of the first is joined to the input of that deconvolution which has its resolution; SkipNet has the same
  five, of its ``CN(k4)``.
- All ReLUs are leaky with the slope given in the paragraph of the encoder, 0.2 and 0.3.
- SkipNet's fully connected layers: one to 256 numbers, leaky ReLU, one to 3 x 256 for normals, albedo and
  light, leaky ReLU, and one to the 27 numbers of the light. The second ReLU is needed for the light not to be
  a linear function of the first layer's response.
- 256 numbers "further up-sampled" to 256 x 4 x 4 are repeated: interpolation of one pixel gives no more.
- Like SfSNet's, convolutions carry biases, normals are made unit vectors, and light is in shading
  coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Final

import torch
from torch import Tensor, nn

from sfsnet_dr.core.conventions import FACE_SIZE, LIGHT_SIZE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.models.base import Network, NetworkOutput
from sfsnet_dr.models.layers import conv, initialise_weights, to_light, to_map, unit_normal

#: Five layers of stride 2 lie between an image and the innermost response.
REDUCTION: Final = 32


class SkipNet(Network):
    """The network of the first stage, with a fully connected bottleneck (18,566,625 parameters).

    Args:
        width: channels of the outermost layers; the others have 2 and 4 times as many.
        size: width and height of its images, which the fully connected layer fixes; a multiple of 32.
    """

    architecture: ClassVar[str] = "skipnet"
    multiple: ClassVar[int] = REDUCTION
    slope: ClassVar[float] = 0.2

    def __init__(self, width: int = 64, size: int = FACE_SIZE) -> None:
        super().__init__({"width": width, "size": size})
        if size % REDUCTION:
            raise InputError(f"size: {size} found, a multiple of {REDUCTION} is needed for a skipnet")
        self.size, self.inner = size, size // REDUCTION
        channels, slope = _channels(width), self.slope
        self.features = channels[-1]
        pairs = zip((3, *channels), channels, strict=False)
        self.encoder = nn.ModuleList(
            _conv(a, b, 4, 2, slope, normalised=number > 0) for number, (a, b) in enumerate(pairs)
        )
        self.bottleneck = nn.Sequential(
            nn.Flatten(), nn.Linear(self.features * self.inner**2, self.features), nn.LeakyReLU(slope)
        )
        self.mlp = nn.Sequential(nn.Linear(self.features, 3 * self.features), nn.LeakyReLU(slope))
        self.normal_decoder = Decoder(self.features, channels, slope)
        self.albedo_decoder = Decoder(self.features, channels, slope)
        self.light_out = nn.Linear(self.features, LIGHT_SIZE)
        initialise_weights(self, slope)

    def forward(self, image: Tensor) -> NetworkOutput:
        """See ``Network``; images have the size that the network was made for."""
        self.check(image)
        responses = []
        x = image
        for layer in self.encoder:
            x = layer(x)
            responses.append(x)
        normal, albedo, light = self.mlp(self.bottleneck(x)).split(self.features, dim=1)
        return NetworkOutput(
            normal=unit_normal(self.normal_decoder(self._blob(normal), responses)),
            albedo=self.albedo_decoder(self._blob(albedo), responses),
            light=to_light(light[:, :, None, None], self.light_out),
        )

    def check(self, image: Tensor) -> None:
        """Refuse images of another size than the network's."""
        super().check(image)
        if tuple(image.shape[-2:]) != (self.size, self.size):
            raise InputError(
                f"image: {image.shape[-2]} x {image.shape[-1]} pixels found, this skipnet was made for "
                f"{self.size} x {self.size}; set data.size in its recipe"
            )

    def _blob(self, features: Tensor) -> Tensor:
        return features[:, :, None, None].expand(-1, -1, self.inner, self.inner)


class SkipNetPlus(Network):
    """The wider, fully convolutional one, any size in multiples of 32 (16,442,593 parameters).

    Args:
        width: channels of the outermost layers; the others have 2 and 4 times as many.
    """

    architecture: ClassVar[str] = "skipnet-plus"
    multiple: ClassVar[int] = REDUCTION
    slope: ClassVar[float] = 0.3

    def __init__(self, width: int = 64) -> None:
        super().__init__({"width": width})
        channels, slope = _channels(width), self.slope
        # Co64(k3) - Co64(k1) - C64(k3), then Co(k1) - C(k3) four times: each k1 keeps the width before it.
        self.entry = _conv(3, width, 3, 1, slope)
        before = (width, *channels[:-1])
        self.encoder = nn.ModuleList(
            nn.Sequential(_conv(a, a, 1, 1, slope), _conv(a, b, 3, 2, slope))
            for a, b in zip(before, channels, strict=True)
        )
        self.normal_entry = _conv(channels[-1], channels[-1], 1, 1, slope)
        self.albedo_entry = _conv(channels[-1], channels[-1], 1, 1, slope)
        self.normal_decoder = Decoder(channels[-1], channels, slope)
        self.albedo_decoder = Decoder(channels[-1], channels, slope)
        self.light_out = nn.Linear(channels[-1], LIGHT_SIZE)
        initialise_weights(self, slope)

    def forward(self, image: Tensor) -> NetworkOutput:
        """See ``Network``."""
        self.check(image)
        responses = []
        x = self.entry(image)
        for layer in self.encoder:
            x = layer(x)
            responses.append(x)
        return NetworkOutput(
            normal=unit_normal(self.normal_decoder(self.normal_entry(x), responses)),
            albedo=self.albedo_decoder(self.albedo_entry(x), responses),
            light=to_light(x, self.light_out),
        )


class Decoder(nn.Module):
    """``CD256 - CD256 - CD256 - CD128 - CD64 - C*3(k1)`` with the encoder's responses joined to each input.

    Args:
        inputs: channels of the innermost input.
        encoder: channels of the encoder's responses, from the outermost.
        slope: of the leaky ReLUs.
    """

    def __init__(self, inputs: int, encoder: Sequence[int], slope: float) -> None:
        super().__init__()
        layers = []
        for skipped in reversed(encoder):  # a layer has as many filters as the encoder's of its input size
            layers.append(_deconv(inputs + skipped, skipped, slope))
            inputs = skipped
        self.layers = nn.ModuleList(layers)
        self.out = conv(inputs, 3, 1)

    def forward(self, x: Tensor, responses: Sequence[Tensor]) -> Tensor:
        """A raw map (B, 3, H, W), float32, from the innermost input and the encoder's responses."""
        for layer, response in zip(self.layers, reversed(responses), strict=True):
            x = layer(torch.cat((x, response), dim=1))
        return to_map(x, self.out)


def _channels(width: int) -> tuple[int, ...]:
    return width, 2 * width, 4 * width, 4 * width, 4 * width


def _conv(
    inputs: int, outputs: int, kernel: int, stride: int, slope: float, *, normalised: bool = True
) -> nn.Sequential:
    """``CN(kS)`` and ``CoN(kS)``: convolution, batch normalisation if wanted, leaky ReLU."""
    layer = nn.Conv2d(inputs, outputs, kernel, stride, padding=(kernel - 1) // 2)
    return nn.Sequential(layer, *_activated(outputs, slope, normalised))


def _deconv(inputs: int, outputs: int, slope: float) -> nn.Sequential:
    """``CDN(k4)``: deconvolution of stride 2, batch normalisation, leaky ReLU; doubles the resolution."""
    return nn.Sequential(nn.ConvTranspose2d(inputs, outputs, 4, 2, padding=1), *_activated(outputs, slope))


def _activated(channels: int, slope: float, normalised: bool = True) -> list[nn.Module]:
    norm = [nn.BatchNorm2d(channels)] if normalised else []
    return [*norm, nn.LeakyReLU(slope, inplace=True)]
