"""What one training step sees: images with the ground truth behind them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from sfsnet_dr.core.conventions import LIGHT_SIZE
from sfsnet_dr.core.errors import InputError, check_shape


def shard(count: int, rank: int, size: int) -> slice:
    """What process ``rank`` of ``size`` has of ``count`` images.

    Raises:
        InputError: if they cannot be dealt out evenly.
    """
    if count % size:
        raise InputError(
            f"batch: {count} images of a kind found, a multiple of the {size} processes is needed"
        )
    return slice(rank * (count // size), (rank + 1) * (count // size))


class FaceBatch(NamedTuple):
    """A batch in the canonical face frame, float32.

    Args:
        image: linear Rec. 709 colour, the network's input, (B, 3, H, W).
        normal: unit vectors in the camera frame (x right, y up, z toward the viewer), (B, 3, H, W).
        albedo: linear reflectance in [0, 1], (B, 3, H, W).
        light: order-2 shading coefficients L = A_l l / pi, 9 R, 9 G, 9 B, (B, 27).
        mask: 1 on the face skin that losses count, 0 elsewhere; fractional on its rim, (B, 1, H, W).
    """

    image: Tensor
    normal: Tensor
    albedo: Tensor
    light: Tensor
    mask: Tensor

    def to(self, device: torch.device | str) -> FaceBatch:
        """The same batch on another device."""
        return FaceBatch(*(tensor.to(device) for tensor in self))

    def check(self) -> FaceBatch:
        """Refuse fields whose shapes do not belong together.

        Raises:
            InputError: naming the field, its shape and the shape expected.
        """
        sizes = check_shape("image", self.image, "B 3 H W")
        check_shape("normal", self.normal, "B 3 H W", **sizes)
        check_shape("albedo", self.albedo, "B 3 H W", **sizes)
        check_shape("light", self.light, f"B {LIGHT_SIZE}", B=sizes["B"])
        check_shape("mask", self.mask, "B 1 H W", **sizes)
        return self


def epoch_indices(seed: int, stream: int, count: int, step: int, batch_size: int) -> list[int]:
    """Which of ``count`` images are in a batch: stretches of one random permutation an epoch."""
    places = range(step * batch_size, (step + 1) * batch_size)
    epochs = {place // count for place in places}
    orders = {e: np.random.default_rng([seed, stream, e]).permutation(count) for e in epochs}
    return [int(orders[place // count][place % count]) for place in places]
