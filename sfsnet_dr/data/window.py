"""Square windows cut from whole batches: as much to learn from each pixel, and fewer pixels.

Much of the canonical frame is no face. A network without fully connected layers sees a part of it here, and
all of it in its last steps.
"""

from __future__ import annotations

from typing import Final, TypeVar

import numpy as np
from torch import Tensor

from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.mixture import MixedBatch

Batch = TypeVar("Batch", FaceBatch, MixedBatch, FaceBatch | MixedBatch)

#: Separates this draw from those of the images themselves.
_STREAM: Final = 20


def cut(batch: Batch, side: int, seed: int, step: int) -> Batch:
    """One window of ``side`` x ``side`` pixels at the same place of all images; the light stays.

    The middle, where faces are, comes most often: an offset is the mean of two that are even. It depends on
    seed and step alone, so that all processes of a team cut alike.

    Args:
        batch: of images at least as large.
        side: in pixels.
        seed: of the run.
        step: number of the batch.
    """
    height, width = batch.image.shape[-2:]
    two = np.random.default_rng([seed, _STREAM, step]).uniform(size=(2, 2))
    row, column = np.floor(two.mean(0) * [height - side + 1, width - side + 1]).astype(int)

    def part(planes: Tensor) -> Tensor:
        return planes[..., row : row + side, column : column + side].contiguous()

    def of_face(face: FaceBatch) -> FaceBatch:
        image, normal, albedo, mask = map(part, (face.image, face.normal, face.albedo, face.mask))
        return FaceBatch(image, normal, albedo, face.light, mask)

    if isinstance(batch, FaceBatch):
        return of_face(batch)
    labelled, real = of_face(batch.labelled), of_face(batch.real)
    return batch._replace(labelled=labelled, real=real, confidence=part(batch.confidence))
