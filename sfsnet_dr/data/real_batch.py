"""Real faces as mini-batches: what every source of them gives, and several sources as one."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.data.batch import FaceBatch


class RealBatch(NamedTuple):
    """Real faces whose labels are trusted more or less.

    Args:
        faces: pictures and labels of B faces.
        confidence: how far normals and albedo are trusted, 0 to 1, (B, 1, H, W).
        free_scale: whether an albedo is known up to a factor, and its light up to the inverse, (B,) bool.
        light_trust: how far the light is trusted, 0 to 1, (B,).
    """

    faces: FaceBatch
    confidence: Tensor
    free_scale: Tensor
    light_trust: Tensor


class RealSource(Protocol):
    """Where real faces come from; batch k depends on a seed and k alone.

    Attributes:
        batch_size: images a batch.
    """

    batch_size: int

    @property
    def fingerprint(self) -> str:
        """Of the data."""

    @property
    def pixels(self) -> tuple[int, int]:
        """Height and width of the images."""

    def names(self, step: int) -> list[str]:
        """Images of a batch."""

    def batch(self, step: int, rank: int = 0, size: int = 1) -> RealBatch:
        """Batch number ``step``, or part ``rank`` of ``size``."""


class RealTogether:
    """Batches with some images of each source, in the order of the sources.

    Raises:
        BadInput: if there is no source, or their images differ in size.
    """

    def __init__(self, sources: Sequence[RealSource]) -> None:
        found = sorted({source.pixels for source in sources})
        if len(found) != 1:
            raise BadInput(f"labels, surfaces: images of {found} pixels found, one size is needed")
        self.sources = tuple(sources)
        self.batch_size = sum(source.batch_size for source in sources)

    @property
    def fingerprint(self) -> str:
        """Of all data; that of the source where there is one."""
        first, *others = (source.fingerprint for source in self.sources)
        return hashlib.sha256("".join([first, *others]).encode()).hexdigest() if others else first

    @property
    def pixels(self) -> tuple[int, int]:
        """Height and width."""
        return self.sources[0].pixels

    def names(self, step: int) -> list[str]:
        """Images of a batch."""
        return [name for source in self.sources for name in source.names(step)]

    def batch(self, step: int, rank: int = 0, size: int = 1) -> RealBatch:
        """Batch number ``step``, or part ``rank`` of ``size`` of every source."""
        faces, *rest = zip(*(source.batch(step, rank, size) for source in self.sources), strict=True)
        joined = (torch.cat(planes) for planes in zip(*faces, strict=True))
        return RealBatch(FaceBatch(*joined), *(torch.cat(part) for part in rest))
