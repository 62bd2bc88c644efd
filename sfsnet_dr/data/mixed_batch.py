"""Mini-batches that mix rendered faces with real ones (pseudo-labels, normal labels, or both).

Source: Sengupta et al., CVPR 2018, section 3 ("SfS-supervision"): every mini-batch mixes both, so that batch
normalisation sees one distribution and no step forgets either.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.batch import FaceBatch, epoch_indices, shard
from sfsnet_dr.data.dataset import RelitFaces
from sfsnet_dr.data.pseudo_labels import Encoding, Labels, PseudoFaces, as_network_input, decode_labels
from sfsnet_dr.data.transforms.mirror import mirror_light, mirror_map, mirror_normal


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


class ConcatSource:
    """Batches with some images of each source, in the order of the sources.

    Raises:
        InputError: if there is no source, or their images differ in size.
    """

    def __init__(self, sources: Sequence[RealSource]) -> None:
        found = sorted({source.pixels for source in sources})
        if len(found) != 1:
            raise InputError(f"labels, surfaces: images of {found} pixels found, one size is needed")
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


@dataclass(frozen=True)
class PseudoLabelOptions:
    """How photographs take part in training.

    Attributes:
        batch_fraction: of each mini-batch; 0 for rendered faces alone.
        flip: probability of a left-right reflection.
        exposure_stops: greatest change of exposure, in stops, always down: what is clipped cannot be brought
            back.
        encoding: what a photograph's numbers are to the network; "srgb" is the paper's form.

    Raises:
        InputError: for a value out of its range.
    """

    RENAMED: ClassVar[dict[str, str]] = {
        "share": "batch_fraction",
        "darker": "exposure_stops",
        "values": "encoding",
    }

    batch_fraction: float = 0.0
    flip: float = 0.5
    exposure_stops: float = 0.5
    encoding: Encoding = field(default="linear")

    def __post_init__(self) -> None:
        for name, largest in (("batch_fraction", 1.0), ("flip", 1.0), ("exposure_stops", 8.0)):
            value = getattr(self, name)
            if not 0 <= value <= largest:
                raise InputError(f"real.{name}: {value:g} found, 0 to {largest:g} allowed")

    def count(self, batch_size: int) -> int:
        """Photographs in a mini-batch; see ``count_real_images``."""
        return count_real_images("real.batch_fraction", self.batch_fraction, batch_size)


def count_real_images(name: str, share: float, batch_size: int) -> int:
    """Images that a share of a mini-batch is.

    Raises:
        InputError: if a share above 0 makes a batch of one kind only.
    """
    count = round(share * batch_size)
    if share and not 0 < count < batch_size:
        raise InputError(f"{name}: {share:g} of {batch_size} images is {count}; both kinds are needed")
    return count


class MixedBatch(NamedTuple):
    """Labelled faces, then real ones."""

    labelled: FaceBatch
    real: RealBatch

    @property
    def image(self) -> Tensor:
        """All images, the labelled ones first."""
        return torch.cat([self.labelled.image, self.real.faces.image])


class RealFaces:
    """Batches of photographs with pseudo-labels; batch k depends on the seed and k alone.

    Args:
        faces: what ``load_pseudo_labels`` gives, on any device; batches are made there.
        batch_size: photographs a batch.
        options: how they vary.
        seed: chooses the sequence.

    Raises:
        InputError: if the labels were made with another meaning of a photograph's numbers.
    """

    def __init__(self, faces: PseudoFaces, batch_size: int, options: PseudoLabelOptions, seed: int) -> None:
        found = faces.spec.get("values")
        if found != options.encoding:
            raise InputError(
                f"real.encoding: {options.encoding!r} found, the pseudo-labels were made with {found!r}"
            )
        self.faces, self.batch_size, self.options, self.seed = faces, batch_size, options, seed

    def indices(self, step: int) -> list[int]:
        """Photographs of a batch."""
        return epoch_indices(self.seed, 10, len(self.faces), step, self.batch_size)

    @property
    def fingerprint(self) -> str:
        """Of the labels."""
        return self.faces.fingerprint

    @property
    def pixels(self) -> tuple[int, int]:
        """Height and width."""
        height, width = self.faces.labels.image.shape[-2:]
        return height, width

    def names(self, step: int) -> list[str]:
        """Photographs of a batch."""
        return [self.faces.names[index] for index in self.indices(step)]

    def batch(self, step: int, rank: int = 0, size: int = 1) -> RealBatch:
        """Batch number ``step``, or part ``rank`` of ``size``; light is trusted as the rest of a face is."""
        part = shard(self.batch_size, rank, size)
        rng = np.random.default_rng([self.seed, 11, step])
        device, count = self.faces.labels.image.device, self.batch_size
        rows = torch.tensor(self.indices(step)[part], device=device)
        picked = Labels(*(planes.index_select(0, rows) for planes in self.faces.labels))
        shown = decode_labels(picked)
        flips = torch.from_numpy(rng.uniform(size=count) < self.options.flip)[part].to(device)
        stops = torch.from_numpy(rng.uniform(-self.options.exposure_stops, 0, count)).float()[part].to(device)
        gain = 2.0**stops
        image = as_network_input(picked.image, self.options.encoding) * gain[:, None, None, None]
        maps = (image, shown.albedo, shown.mask, shown.confidence)
        turned = flips[:, None, None, None]
        image, albedo, mask, confidence = (torch.where(turned, mirror_map(planes), planes) for planes in maps)
        normal = torch.where(turned, mirror_normal(shown.normal), shown.normal)
        light = torch.where(flips[:, None], mirror_light(shown.light), shown.light) * gain[:, None]
        faces = FaceBatch(image, normal, albedo, light, mask)
        trust = (mask * confidence).sum((1, 2, 3)) / mask.sum((1, 2, 3)).clamp_min(1)
        return RealBatch(faces, confidence, torch.zeros_like(trust, dtype=torch.bool), trust)


class MixedFaces:
    """Batches of both kinds; batch k depends on the two sequences' seeds and k alone.

    Raises:
        InputError: if the two have pictures of different sizes.
    """

    def __init__(self, labelled: RelitFaces, real: RealSource) -> None:
        found, size = real.pixels, tuple(labelled.faces.normal.shape[-2:])
        if found != size:
            raise InputError(
                f"labels: {found[0]} x {found[1]} pixels found, {size[0]} x {size[1]} as the "
                "rendered faces have is needed; label the photographs at that --size"
            )
        self.labelled, self.real = labelled, real

    @property
    def fingerprint(self) -> str:
        """Of all data."""
        both = self.labelled.fingerprint + self.real.fingerprint
        return hashlib.sha256(both.encode()).hexdigest()

    def batch(self, step: int, rank: int = 0, size: int = 1) -> MixedBatch:
        """Batch number ``step``, or part ``rank`` of ``size`` of both kinds."""
        return MixedBatch(self.labelled.batch(step, rank, size), self.real.batch(step, rank, size))

    def names(self, step: int) -> list[str]:
        """The faces and photographs of a batch."""
        return self.labelled.names(step) + self.real.names(step)
