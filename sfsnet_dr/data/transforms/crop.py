"""What a network is shown of the canonical frame: a square in its middle, at the network's resolution.

The frame leaves room for hair, ears and neck. A network that is shown less of it sees the face with more
pixels for the same cost, and answers for what it was shown alone.
"""

from __future__ import annotations

from functools import cache
from typing import Final, NamedTuple

import torch
from torch import Tensor

from sfsnet_dr.core.conventions import FACE_SIZE
from sfsnet_dr.core.errors import InputError


class Crop(NamedTuple):
    """A square of ``crop`` of the frame's 128 pixels, shown with ``size`` pixels.

    Attributes:
        size: width and height of the images.
        crop: width and height of what they show, in pixels of the canonical frame.
    """

    size: int = FACE_SIZE
    crop: int = FACE_SIZE

    def apply(self, planes: Tensor) -> Tensor:
        """Planes of the whole frame (..., N, N), any N, as this view shows them, (..., size, size).

        Each pixel is the mean over the square that it covers: what a sensor of fewer pixels sees. Unit
        vectors come out shorter.

        Raises:
            InputError: if they are not square, or have fewer pixels there than are to be shown.
        """
        height, width = planes.shape[-2:]
        if height != width or self._step(width) < 1:
            needed = -(-self.size * FACE_SIZE // self.crop)
            raise InputError(
                f"{height} x {width} pixels found, a square of {needed} or more is needed to show "
                f"{self.crop} of {FACE_SIZE} with {self.size}"
            )
        return _both_axes(_means(self, width).to(planes), planes)

    def invert(self, planes: Tensor, pixels: int) -> Tensor:
        """An answer (..., size, size) interpolated onto the whole frame (..., N, N) of N = ``pixels``.

        Beyond the view the nearest answer stands; ``coverage`` tells where that is.
        """
        return _both_axes(_interpolation(self, pixels).to(planes), planes)

    def coverage(self, pixels: int) -> Tensor:
        """Share of each of N x N pixels of the frame that is shown, (N, N) float32 in [0, 1]."""
        edges = torch.arange(pixels + 1, dtype=torch.float64).clamp(*self._sides(pixels))
        share = edges.diff().float()
        return share[:, None] * share[None, :]

    def _sides(self, pixels: int) -> tuple[float, float]:
        """Where the view begins and ends in a frame of so many pixels."""
        shown = pixels * self.crop / FACE_SIZE
        return (pixels - shown) / 2, (pixels + shown) / 2

    def _step(self, pixels: int) -> float:
        """Pixels of such a frame that are one of the view's."""
        return pixels * self.crop / FACE_SIZE / self.size


#: All of the frame with all of its pixels.
WHOLE: Final = Crop()


def _both_axes(matrix: Tensor, planes: Tensor) -> Tensor:
    return matrix @ planes @ matrix.mT


@cache
def _means(view: Crop, pixels: int) -> Tensor:
    """(size, pixels): share of each pixel of the frame in each of the view's; rows sum to 1."""
    begin, step = view._sides(pixels)[0], view._step(pixels)
    edges = begin + step * torch.arange(view.size + 1, dtype=torch.float64)
    places = torch.arange(pixels, dtype=torch.float64)
    overlap = torch.minimum(edges[1:, None], places + 1) - torch.maximum(edges[:-1, None], places)
    return (overlap.clamp_min(0) / step).float()


@cache
def _interpolation(view: Crop, pixels: int) -> Tensor:
    """(pixels, size): linear weights of the view's pixels at the centres of the frame's."""
    begin, step = view._sides(pixels)[0], view._step(pixels)
    centres = torch.arange(pixels, dtype=torch.float64) + 0.5
    places = ((centres - begin) / step - 0.5).clamp(0, view.size - 1)
    distance = (places[:, None] - torch.arange(view.size, dtype=torch.float64)).abs()
    return (1 - distance).clamp_min(0).float()
