"""Faces whose normals photometric stereo found, as mini-batches to fine-tune on, with a split by identity.

Who is held back follows from the subject's name alone: of ``folds`` equal parts of all hashes of names it is
part ``fold``. So nobody changes sides when subjects are added or left out, and with every fold trained once
everybody is measured once by a network that was never told their normals.

The albedo of such labels is known up to a factor (the lamps' absolute strength is not known) and grey where
the pictures are. The median capture is given the albedo of usual skin; ``free_scale`` says to the loss that
others may differ.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import torch
from torch.nn import functional

from sfsnet_dr.core.config import added_field
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.batch import FaceBatch, epoch_indices, shard
from sfsnet_dr.data.mixed_batch import RealBatch, count_real_images
from sfsnet_dr.data.normal_labels import NormalLabels, light_labels, load_normal_labels, read_index
from sfsnet_dr.data.transforms.affine import InPlane
from sfsnet_dr.data.transforms.camera import metering_gain
from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.data.transforms.mirror import mirror_light, mirror_map, mirror_normal

#: Mean albedo over the face of usual skin: the median of 200 rendered faces, which are evenly spread over the
#: individual typology angle; their 5th and 95th percentiles are 0.06 and 0.34.
USUAL_ALBEDO: Final = 0.175


@dataclass(frozen=True)
class NormalLabelOptions:
    """How faces with labels by photometric stereo take part in training.

    Attributes:
        batch_fraction: of each mini-batch; 0 for none.
        flip: probability of a left-right reflection.
        exposure: greatest change of exposure, in stops, either way, after the metering that measuring does
            too.
        roll, scale, shift: greatest turn within the image in degrees, relative change of size, and move as a
            share of the image's width, each either way: they keep a network from knowing few people by where
            their features are.
        folds: parts that all subjects are split into by their names; 1 for none, everybody is learnt from.
        fold: the part that is held back, 0 to folds - 1; means nothing with one part.

    Raises:
        InputError: for a value out of its range.
    """

    RENAMED: ClassVar[dict[str, str]] = {"share": "batch_fraction"}

    batch_fraction: float = 0.0
    flip: float = 0.5
    exposure: float = 0.5
    folds: int = 4
    fold: int = 0
    roll: float = added_field(0.0)
    scale: float = added_field(0.0)
    shift: float = added_field(0.0)

    def __post_init__(self) -> None:
        ranges: dict[str, tuple[float, float]] = {
            "batch_fraction": (0, 1),
            "flip": (0, 1),
            "exposure": (0, 4),
            "folds": (1, 1000),
        }
        ranges |= {"fold": (0, self.folds - 1), "roll": (0, 45), "scale": (0, 0.5), "shift": (0, 0.25)}
        for name, (least, most) in ranges.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise InputError(f"surfaces.{name}: {value:g} found, {least} to {most} allowed")

    def moves(self, rng: np.random.Generator, count: int, width: int) -> InPlane | None:
        """A move for each of some pictures, ``width`` pixels wide; None if none is asked for."""
        if not (self.roll or self.scale or self.shift):
            return None
        roll, scale, *shift = rng.uniform(-1, 1, (4, count))
        return InPlane(
            torch.from_numpy(np.radians(self.roll) * roll).float(),
            torch.from_numpy(1 + self.scale * scale).float(),
            torch.from_numpy(self.shift * width * np.stack(shift, 1)).float(),
        )

    def count(self, batch_size: int) -> int:
        """Images in a mini-batch; see ``data.mixture.count_of``."""
        return count_real_images("normal_labels.batch_fraction", self.batch_fraction, batch_size)


def fold_of(subject: str, folds: int) -> int:
    """The part, 0 to folds - 1, that a subject belongs to: a function of the name alone."""
    return int(hashlib.sha256(subject.encode()).hexdigest()[:12], 16) % folds


@dataclass(frozen=True)
class IdentitySplit:
    """Who was learnt from, stored with the weights.

    Attributes:
        database: whose names these are.
        folds, fold: see ``NormalLabelOptions``.
        learnt: subjects trained on.
        held_back: subjects whose labels training never sees.
        calibrated_by: the network that helped to find where the lamps were; empty where the database told it,
            and the labels are its truth.
        seen: those held back whose pictures the network had learnt from before, without their truth.
    """

    database: str
    folds: int
    fold: int
    learnt: tuple[str, ...]
    held_back: tuple[str, ...]
    calibrated_by: str = ""
    seen: tuple[str, ...] = ()

    @property
    def metadata(self) -> dict[str, Any]:
        """As JSON values."""
        return {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(self).items()}


def read_split(metadata: dict[str, Any]) -> IdentitySplit | None:
    """The split in the metadata of weights, None if they were not trained with one."""
    found = metadata.get("normal_labels")
    if found is None:
        return None
    return IdentitySplit(
        found["database"],
        found["folds"],
        found["fold"],
        tuple(found["learnt"]),
        tuple(found["held_back"]),
        found.get("calibrated_by", ""),
        tuple(found.get("seen", ())),
    )


def split_subjects(subjects: Iterable[str], options: NormalLabelOptions, database: str) -> IdentitySplit:
    """Deal subjects to training and measuring.

    Raises:
        InputError: with fewer than two subjects, or if all or none would be held back, unless ``folds`` is 1.
    """
    names = sorted(set(subjects))
    if options.folds == 1:
        return IdentitySplit(database, 1, 0, tuple(names), ())
    if len(names) < 2:
        raise InputError(f"surfaces: {len(names)} subject found, two are needed to hold one back")
    held = [name for name in names if fold_of(name, options.folds) == options.fold]
    if len(held) in (0, len(names)):
        which = "all" if held else "none"
        raise InputError(
            f"surfaces.fold: {which} of {len(names)} subjects would be held back by fold {options.fold} of "
            f"{options.folds}; choose another"
        )
    learnt = tuple(name for name in names if name not in held)
    return IdentitySplit(database, options.folds, options.fold, learnt, tuple(held))


def load_training_subjects(
    folder: Path | str, options: NormalLabelOptions, view: Crop | None = None
) -> tuple[list[NormalLabels], IdentitySplit]:
    """The captures to learn from, as a view shows them, and who they and the others are.

    Raises:
        InputError: for unusable labels, see ``load_normal_labels``, or subjects that cannot be split.
    """
    faces = load_normal_labels(folder)
    index = read_index(folder)
    split = split_subjects([face.subject for face in faces], options, index["database"])
    split = replace(split, calibrated_by=index.get("calibrated_by", ""))
    return [_shown(face, view) for face in faces if face.subject in split.learnt], split


class NormalLabelFaces:
    """Batches of pictures under known lights; batch k depends on the seed and k alone.

    Args:
        faces: captures, all of one size.
        batch_size: pictures a batch.
        options: how they vary.
        seed: chooses the sequence.
        device: where batches are made.

    Raises:
        InputError: if there is no capture, or they differ in size.
    """

    def __init__(
        self,
        faces: Sequence[NormalLabels],
        batch_size: int,
        options: NormalLabelOptions,
        seed: int,
        device: torch.device | str = "cpu",
    ) -> None:
        if len({face.normal.shape for face in faces}) != 1:
            raise InputError(f"surfaces: {len(faces)} captures found, one or more of one size are needed")
        self.batch_size, self.options, self.seed = batch_size, options, seed
        self.subjects = tuple(face.subject for face in faces)
        colours = max(len(face.albedo) for face in faces)
        pictures = [face.image.expand(-1, colours, -1, -1) for face in faces]
        self._owner = torch.cat([torch.full((len(p),), k) for k, p in enumerate(pictures)]).to(device)
        self._image = torch.cat(pictures).half().to(device)
        scale = USUAL_ALBEDO / max(float(np.median([_mean_albedo(face) for face in faces])), 1e-6)
        lights = [light_labels(face.direction.numpy(), face.gain.numpy()) for face in faces]
        self._light = torch.from_numpy(np.concatenate(lights) / scale).float().to(device)
        self._normal = torch.stack([face.normal for face in faces]).to(device)
        self._albedo = torch.stack([scale * face.albedo.expand(3, -1, -1) for face in faces]).to(device)
        self._mask = torch.stack([face.mask for face in faces]).to(device)
        self._confidence = torch.stack([face.confidence for face in faces]).to(device)
        self._names = [f"{face.name}: {light}" for face in faces for light in face.lights]

    def __len__(self) -> int:
        return len(self._names)

    @property
    def fingerprint(self) -> str:
        """Of the pictures, their labels and their names."""
        digest = hashlib.sha256("\n".join(self._names).encode())
        for planes in (self._image, self._normal, self._albedo, self._mask, self._confidence, self._light):
            digest.update(planes.cpu().contiguous().numpy().tobytes())
        return digest.hexdigest()

    @property
    def pixels(self) -> tuple[int, int]:
        """Height and width."""
        height, width = self._image.shape[-2:]
        return height, width

    def indices(self, step: int) -> list[int]:
        """Pictures of a batch."""
        return epoch_indices(self.seed, 12, len(self), step, self.batch_size)

    def names(self, step: int) -> list[str]:
        """Captures and lights of a batch."""
        return [self._names[index] for index in self.indices(step)]

    def batch(self, step: int, rank: int = 0, size: int = 1) -> RealBatch:
        """Batch number ``step``, or part ``rank`` of ``size``."""
        part, count = shard(self.batch_size, rank, size), self.batch_size
        rng = np.random.default_rng([self.seed, 13, step])
        device = self._image.device
        rows = torch.tensor(self.indices(step)[part], device=device)
        owner = self._owner[rows]
        flips = torch.from_numpy(rng.uniform(size=count) < self.options.flip)[part].to(device)
        stops = torch.from_numpy(rng.uniform(-1, 1, count) * self.options.exposure).float()[part].to(device)
        moves = self.options.moves(rng, count, self.pixels[1])
        mask, confidence, albedo = self._mask[owner], self._confidence[owner], self._albedo[owner]
        image = self._image[rows].float().expand(-1, 3, -1, -1)
        gain = metering_gain(image, mask)[:, 0, 0, 0] * 2.0**stops
        image = (image * gain[:, None, None, None]).clamp(0, 1)
        turned = flips[:, None, None, None]
        image, albedo, mask, confidence = (
            torch.where(turned, mirror_map(planes), planes) for planes in (image, albedo, mask, confidence)
        )
        normal = torch.where(turned, mirror_normal(self._normal[owner]), self._normal[owner])
        light = torch.where(flips[:, None], mirror_light(self._light[rows]), self._light[rows])
        if moves is not None:
            move = moves.part(part, device)
            image, albedo, confidence = (move.map(planes) for planes in (image, albedo, confidence))
            normal, light, mask = move.normal(normal), move.light(light), move.mask(mask)
        faces = FaceBatch(image, normal, albedo, light * gain[:, None], mask)
        return RealBatch(faces, confidence, torch.ones_like(flips), torch.ones_like(gain))


def _mean_albedo(face: NormalLabels) -> float:
    weight = face.mask * face.confidence
    return float((weight * face.albedo).sum() / (len(face.albedo) * weight.sum()).clamp_min(1e-6))


def _shown(face: NormalLabels, view: Crop | None) -> NormalLabels:
    if view is None or view == Crop(face.normal.shape[-1]):
        return face
    try:
        planes: dict[str, Any] = {
            name: view.apply(getattr(face, name))
            for name in ("image", "normal", "albedo", "mask", "confidence", "residual")
        }
    except InputError as error:
        raise InputError(f"surfaces: {error}; see data.size and data.crop") from error
    planes["normal"] = functional.normalize(planes["normal"], dim=0)
    return replace(face, **planes)
