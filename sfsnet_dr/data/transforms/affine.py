"""Moves of a face within its image: rolled, larger or smaller, shifted; normals and light roll with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

#: Of a mask that is 1 or 0, between pixels: less than this means that one of the four is outside.
INSIDE: Final = 0.999


@dataclass(frozen=True)
class InPlane:
    """One move for each of B images, about the middle of the image.

    Attributes:
        roll: radians, counter-clockwise as one looks at the image, (B,).
        scale: above 1 the face becomes larger, (B,).
        shift: pixels to the right and down, (B, 2).
    """

    roll: Tensor
    scale: Tensor
    shift: Tensor

    def part(self, rows: slice, device: torch.device) -> InPlane:
        """Some of the moves, where their images are."""
        return InPlane(*(part[rows].to(device) for part in (self.roll, self.scale, self.shift)))

    def map(self, planes: Tensor) -> Tensor:
        """Images (B, C, H, W) whose values do not depend on direction, bilinearly; 0 beyond the edges."""
        height, width = planes.shape[-2:]
        sin, cos = torch.sin(self.roll) / self.scale, torch.cos(self.roll) / self.scale
        # From where a pixel is taken: the inverse move, in units of half the image, with y down.
        right, down = self.shift[:, 0] * 2 / width, self.shift[:, 1] * 2 / height
        across, along = sin * (height / width), sin * (width / height)
        rows = torch.stack(
            [cos, -across, across * down - cos * right, along, cos, -along * right - cos * down], 1
        )
        grid = functional.affine_grid(rows.reshape(-1, 2, 3), list(planes.shape), align_corners=False)
        return functional.grid_sample(planes, grid, mode="bilinear", align_corners=False)

    def mask(self, mask: Tensor) -> Tensor:
        """A mask (B, 1, H, W) of 0 and 1: 1 where all that is interpolated lies within it."""
        return (self.map(mask) >= INSIDE).to(mask.dtype)

    def normal(self, normal: Tensor) -> Tensor:
        """Unit normals (B, 3, H, W), moved and rolled; 0 where there are none."""
        x, y, z = functional.normalize(self.map(normal), dim=1).unbind(1)
        sin, cos = torch.sin(self.roll)[:, None, None], torch.cos(self.roll)[:, None, None]
        return torch.stack([cos * x - sin * y, sin * x + cos * y, z], 1)

    def light(self, light: Tensor) -> Tensor:
        """Coefficients (B, 3K), all of red, of green, of blue, turned about z.

        Each pair of cos(m phi) and sin(m phi) turns by m times the roll.
        """
        count = light.shape[1] // 3
        channels, result = light.reshape(-1, 3, count), []
        for band in range(int(count**0.5)):
            first = band * band
            result.append(channels[..., first])
            for m in range(1, band + 1):
                even, odd = channels[..., first + 2 * m - 1], channels[..., first + 2 * m]
                sin, cos = torch.sin(m * self.roll)[:, None], torch.cos(m * self.roll)[:, None]
                result += [cos * even - sin * odd, sin * even + cos * odd]
        return torch.stack(result, -1).reshape(light.shape)
