"""Photographs to learn from and to measure on, from a folder or, where there are none, rendered ones."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import torch

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.base.color_torch import linear_to_srgb
from sfsnet_dr.data.augment import Augmentation
from sfsnet_dr.data.dataset import Faces, RelitFaces
from sfsnet_dr.data.light_bank import draw_bank
from sfsnet_dr.data.photo_set import PhotoSet, hold_back, list_photos, load_photos
from sfsnet_dr.data.view import View

#: Lights that rendered photographs are taken under, and the seed that sets them apart from training's.
_LIGHTS: Final = 256
_SEED: Final = 7_000_001

Load = Callable[[Sequence[str], View], PhotoSet]


@dataclass(frozen=True, eq=False)
class PhotoSource:
    """Photographs by name.

    Attributes:
        train: names of those to learn from.
        held: names of those kept for measuring.
        skipped: reasons by name, for those that cannot be used.
        load: reads photographs, given names and a view.
        rendered: whether they are no photographs but rendered faces that stand in for them.
        identity: what decides them beside their names.
    """

    train: tuple[str, ...]
    held: tuple[str, ...]
    skipped: Mapping[str, str]
    load: Load
    rendered: bool = False
    identity: str = field(default="")

    @property
    def fingerprint(self) -> str:
        """Of those to learn from."""
        return hashlib.sha256("\n".join([*self.train, *filter(None, [self.identity])]).encode()).hexdigest()


def photo_folder(folder: Path | str, *, held_back: int, most: int | None = None) -> PhotoSource:
    """The photographs of a folder, see ``data.photo_set``.

    Args:
        folder: photographs with landmarks.
        held_back: how many are kept for measuring.
        most: learn from no more than these many.

    Raises:
        BadInput: for an unusable folder.
    """
    listed, skipped = list_photos(folder)
    train, held = hold_back(listed, held_back)
    known = {photo.name: photo for photo in listed}

    def load(names: Sequence[str], view: View) -> PhotoSet:
        return load_photos([known[name] for name in names], view)

    return PhotoSource(
        tuple(photo.name for photo in train[:most]),
        tuple(photo.name for photo in held),
        {item.name: item.reason for item in skipped},
        load,
    )


def stand_ins(
    train: Faces, held: Faces, augmentation: Augmentation, *, held_back: int, most: int
) -> PhotoSource:
    """Rendered faces photographed under lights of their own, as 8-bit pictures: photographs in form only.

    Args:
        train, held: faces of one size, those that networks learn from and those kept for measuring.
        augmentation: how training images vary; these vary likewise.
        held_back: pictures to measure on, of held faces.
        most: pictures to learn from.
    """
    bank = draw_bank(augmentation.light, min(augmentation.lights, _LIGHTS), _SEED)
    parts = {
        kind: RelitFaces(faces, 1, replace(augmentation, held_back=0), _SEED, bank)
        for kind, faces in (("train", train), ("held", held))
    }

    def load(names: Sequence[str], view: View) -> PhotoSet:
        found = View(train.normal.shape[-1], augmentation.crop)
        if view != found:
            raise BadInput(f"{view} found, the rendered photographs are {found}")
        return _photographed([(parts[kind], int(number)) for kind, number in map(_split, names)], names)

    return PhotoSource(
        tuple(f"train-{number:06d}" for number in range(most)),
        tuple(f"held-{number:06d}" for number in range(held_back)),
        {},
        load,
        rendered=True,
        identity=train.fingerprint + held.fingerprint + bank.fingerprint,
    )


def _split(name: str) -> tuple[str, str]:
    kind, _, number = name.partition("-")
    return kind, number


def _photographed(wanted: Sequence[tuple[RelitFaces, int]], names: Sequence[str]) -> PhotoSet:
    batches = [faces.batch(number) for faces, number in wanted]
    images, masks = (torch.cat([batch[place] for batch in batches]) for place in (0, 4))
    shown = (linear_to_srgb(images.clamp(0, 1)) * 255).round().to(torch.uint8)
    hashes = [hashlib.sha256(image.numpy().tobytes()).hexdigest() for image in shown]
    return PhotoSet(shown, (masks * 255).round().to(torch.uint8), tuple(names), tuple(hashes), ())
