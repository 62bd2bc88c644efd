"""What varies between the images of one face besides the light: exposure, background, noise, clipping."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from sfsnet_dr.base.checks import BadInput

#: Share of white's signal that is added to the signal before shot noise is drawn: the read noise.
READ_NOISE: Final = 0.02

#: Cells along each side of a patterned background.
BACKGROUND_CELLS: Final = 6


@dataclass(frozen=True)
class Augmentation:
    """How images are varied.

    Args:
        flip: probability of a left-right reflection.
        exposure: largest change of exposure either way, in stops; the light label follows it.
        noise: largest standard deviation of sensor noise at signal 1; each image draws its own level
            uniformly from 0 up to it, and variance grows linearly with the signal.
        clip: keep [0, 1] only, as a display-referred picture does.

    Raises:
        BadInput: for a value out of its range.
    """

    flip: float = 0.5
    exposure: float = 0.3
    noise: float = 0.01
    clip: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.flip <= 1:
            raise BadInput(f"flip: {self.flip} found, a probability from 0 to 1 is needed")
        for name in ("exposure", "noise"):
            if not getattr(self, name) >= 0:
                raise BadInput(f"{name}: {getattr(self, name)} found, 0 or more is needed")


def backgrounds(rng: np.random.Generator, count: int, height: int, width: int) -> Tensor:
    """Linear backgrounds (count, 3, H, W) in [0, 1]: by turns of chance one colour or a soft pattern."""
    colours = rng.uniform(0, 1, (count, 3, 1, 1)) ** 2
    patterns = rng.uniform(0, 1, (count, 3, BACKGROUND_CELLS, BACKGROUND_CELLS)) ** 2
    patterned = rng.uniform(size=(count, 1, 1, 1)) < 0.5
    cells = torch.from_numpy(np.where(patterned, patterns, colours)).float()
    return functional.interpolate(cells, (height, width), mode="bilinear", align_corners=False)


def add_noise(image: Tensor, rng: np.random.Generator, largest: float) -> Tensor:
    """Add noise of variance level^2 (signal + ``READ_NOISE``) to (B, 3, H, W); each image has its level."""
    level = torch.from_numpy(rng.uniform(0, largest, (len(image), 1, 1, 1))).float()
    normal = torch.from_numpy(rng.standard_normal(tuple(image.shape), dtype=np.float32))
    return image + level * (image.clamp_min(0) + READ_NOISE).sqrt() * normal
