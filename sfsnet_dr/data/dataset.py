"""A folder of bundles as an endless, repeatable sequence of freshly relit training batches."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.base.conventions import LIGHT_ORDER
from sfsnet_dr.data.augment import Augmentation, add_noise, backgrounds
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.bundle import Bundle, read_bundle
from sfsnet_dr.data.flip import flip_map, flip_normal, flip_transport
from sfsnet_dr.data.manifest import NAME, Manifest
from sfsnet_dr.data.relight import relight_batch
from sfsnet_dr.sh.priors import sample_lights


@dataclass(frozen=True)
class Faces:
    """N faces of one size in memory, half precision: 1.1 MB a face of 128 x 128.

    Args:
        normal: (N, 3, H, W), ``albedo`` likewise; ``mask`` and ``coverage``: (N, 1, H, W).
        transport: order-2 light transport, (N, 9, 3, H, W).
        names: N file names.
        fingerprint: of the bundles' hashes; the same for the same data.
    """

    normal: Tensor
    albedo: Tensor
    mask: Tensor
    coverage: Tensor
    transport: Tensor
    names: tuple[str, ...]
    fingerprint: str

    def __len__(self) -> int:
        return len(self.names)


def load_faces(folder: Path | str) -> Faces:
    """Read every bundle that a folder's manifest lists, in the order of their seeds.

    Raises:
        BadInput: if there is no manifest, it is empty, or a bundle is missing, damaged, of another size,
            of too low an order, or has an empty mask.
    """
    folder = Path(folder)
    entries = sorted(Manifest(folder).entries, key=lambda entry: (entry.seed, entry.file))
    if not entries:
        raise BadInput(f"{folder}: no bundles listed in {NAME}; render some with `sfsnet-dr synth`")
    planes: dict[str, list[Tensor]] = {}
    for entry in entries:
        path = folder / entry.file
        for name, tensor in _tensors(path, read_bundle(path)).items():
            group = planes.setdefault(name, [])
            group.append(tensor)
            if tensor.shape != group[0].shape:
                found, allowed = tuple(tensor.shape[-2:]), tuple(group[0].shape[-2:])
                raise BadInput(f"{path}: {found} pixels found, {allowed} expected as in {entries[0].file}")
    digest = hashlib.sha256("".join(entry.sha256 for entry in entries).encode()).hexdigest()
    stacked = {name: torch.stack(tensors) for name, tensors in planes.items()}
    return Faces(**stacked, names=tuple(entry.file for entry in entries), fingerprint=digest)


def _tensors(path: Path, bundle: Bundle) -> dict[str, Tensor]:
    count = (LIGHT_ORDER + 1) ** 2
    if len(bundle.transport) < count:
        raise BadInput(f"{path}: {len(bundle.transport)} transport coefficients found, {count} are needed")
    if not bundle.mask.any():
        raise BadInput(f"{path}: the mask is empty; a face must be in the picture")
    arrays = {
        "normal": np.moveaxis(bundle.normal, -1, 0),
        "albedo": np.moveaxis(bundle.albedo, -1, 0),
        "mask": bundle.mask[None],
        "coverage": bundle.coverage[None],
        "transport": np.moveaxis(bundle.transport[:count], -1, 1),
    }
    return {name: torch.from_numpy(np.ascontiguousarray(a)).half() for name, a in arrays.items()}


class RelitFaces:
    """Batches of faces under lights nobody rendered.

    Batch k depends on the seed and on k alone: whoever computes it, in whatever order, gets the same, so
    that a resumed run needs no generator's state. Every face is seen once before one is seen again.

    Args:
        faces: what ``load_faces`` gives.
        batch_size: images a batch.
        augmentation: how they vary.
        seed: chooses the sequence.
    """

    def __init__(self, faces: Faces, batch_size: int, augmentation: Augmentation, seed: int) -> None:
        self.faces = faces
        self.batch_size = batch_size
        self.augmentation = augmentation
        self.seed = seed

    def indices(self, step: int) -> list[int]:
        """Faces of a batch: stretches of one random permutation an epoch."""
        places = range(step * self.batch_size, (step + 1) * self.batch_size)
        count = len(self.faces)
        epochs = {place // count for place in places}
        orders = {e: np.random.default_rng([self.seed, 0, e]).permutation(count) for e in epochs}
        return [int(orders[place // count][place % count]) for place in places]

    def batch(self, step: int) -> FaceBatch:
        """Batch number ``step``, relit and augmented, on the CPU."""
        rng = np.random.default_rng([self.seed, 1, step])
        chosen = self.indices(step)
        flips = torch.from_numpy(rng.uniform(size=len(chosen)) < self.augmentation.flip)
        normal = _reflect(self.faces.normal[chosen].float(), flips, flip_normal)
        albedo, mask, coverage = (
            _reflect(part[chosen].float(), flips, flip_map)
            for part in (self.faces.albedo, self.faces.mask, self.faces.coverage)
        )
        transport = _reflect(self.faces.transport[chosen], flips, flip_transport)
        radiance, light = self._lights(rng)
        image = self._finish(relight_batch(transport, radiance), coverage, rng)
        return FaceBatch(image, _renormalised(normal), albedo, light, mask)

    def _lights(self, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Radiance (B, 9, 3) for the transport, and the same lights as shading labels (B, 27)."""
        reach = self.augmentation.exposure
        stops = rng.uniform(-reach, reach, self.batch_size)
        lights = [light.coefficients(LIGHT_ORDER) for light in sample_lights(rng, self.batch_size)]
        lights = [light * 2.0**stop for light, stop in zip(lights, stops, strict=True)]
        radiance = np.stack([light.values for light in lights])
        labels = np.stack([light.to_shading().flat() for light in lights])
        return torch.from_numpy(radiance).float(), torch.from_numpy(labels).float()

    def _finish(self, image: Tensor, coverage: Tensor, rng: np.random.Generator) -> Tensor:
        behind = backgrounds(rng, len(image), image.shape[-2], image.shape[-1])
        image = add_noise(image + (1 - coverage) * behind, rng, self.augmentation.noise)
        return image.clamp(0, 1) if self.augmentation.clip else image


def _reflect(values: Tensor, flips: Tensor, reflect: Callable[[Tensor], Tensor]) -> Tensor:
    values[flips] = reflect(values[flips])
    return values


def _renormalised(normal: Tensor) -> Tensor:
    """Undo the rounding to half; where there is no surface the zero vector stays."""
    length = normal.norm(dim=1, keepdim=True)
    return torch.where(length > 0.5, normal / length.clamp_min(0.5), normal)
