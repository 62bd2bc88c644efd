"""Folders of photographs with landmarks as training data, split into training and validation.

A folder of photographs has an ``.npz`` with ``files`` (N names) and ``points`` (N, 68, 2) in the pixels of
the photographs: ``landmarks.npz`` in it, or ``NAME_landmarks.npz`` beside the folder NAME. A folder of such
folders is taken too.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from sfsnet_dr.core.color import linear_to_srgb
from sfsnet_dr.core.color_torch import linear_to_srgb as linear_to_srgb_torch
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.image_io import read_image
from sfsnet_dr.data.alignment import (
    COUNT,
    canonical_coverage,
    canonical_landmarks,
    eye_centres,
    skin_mask,
    to_canonical,
)
from sfsnet_dr.data.dataset import Faces, RelitFaces
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.data.transforms.crop import WHOLE, Crop
from sfsnet_dr.scene.lights.cache import draw_lights

Array = npt.NDArray[np.float64]

PICTURES: Final = frozenset({".jpg", ".jpeg", ".png"})
#: What may lie beside photographs without being one.
_ASIDE: Final = frozenset({".npz", ".txt", ".md", ".toml"})


@dataclass(frozen=True, eq=False)
class Photo:
    """A photograph with its landmarks (68, 2); ``name`` is its path below the folder that was given."""

    name: str
    path: Path
    points: Array


@dataclass(frozen=True)
class SkippedPhotos:
    """A photograph that cannot be used, and why."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class PhotoSet:
    """N photographs of one size in memory.

    Attributes:
        images: sRGB-encoded, (N, 3, S, S) uint8.
        masks: share of each pixel that is skin in 255ths, (N, 1, S, S) uint8.
        names: N names.
        hashes: SHA-256 of the files.
        skipped: those that could not be read.
    """

    images: Tensor
    masks: Tensor
    names: tuple[str, ...]
    hashes: tuple[str, ...]
    skipped: tuple[SkippedPhotos, ...]

    def __len__(self) -> int:
        return len(self.names)


def list_photos(folder: Path | str) -> tuple[list[Photo], list[SkippedPhotos]]:
    """All photographs of a folder in the order of their names, and those without usable landmarks.

    Raises:
        InputError: if the folder is missing, empty, mixed with other files, or lacks landmarks; or if none of
            its photographs has landmarks.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; a folder of photographs is needed")
    photos, skipped = [], []
    for part in _parts(folder):
        known = _landmarks(part)
        for path in _pictures(part):
            name = path.relative_to(folder).as_posix()
            reason = _unusable(known.get(path.name))
            if reason:
                skipped.append(SkippedPhotos(name, reason))
            else:
                photos.append(Photo(name, path, known[path.name]))
    if not photos:
        raise InputError(f"{folder}: none of {len(skipped)} photographs has landmarks; {skipped[0].reason}")
    return photos, skipped


def split_holdout(photos: Sequence[Photo], count: int, seed: int = 0) -> tuple[list[Photo], list[Photo]]:
    """Split into photographs to learn from and ``count`` to measure on, by a hash of the seed and the name.

    Whether one is held back hardly depends on which others are there.

    Raises:
        InputError: unless fewer than half are held back.
    """
    if not 0 <= count < max(1, len(photos) / 2):
        raise InputError(f"held back: {count} of {len(photos)} photographs found, less than half is allowed")
    ranks = sorted(photos, key=lambda photo: hashlib.sha256(f"{seed}/{photo.name}".encode()).digest())
    held = {photo.name for photo in ranks[:count]}
    return [p for p in photos if p.name not in held], [p for p in photos if p.name in held]


def load_photos(
    photos: Sequence[Photo], view: Crop = WHOLE, on_photo: Callable[[], object] | None = None
) -> PhotoSet:
    """Read photographs, bring each to the canonical frame and show it as ``view`` says, in linear light.

    Args:
        photos: of ``list_photos``.
        view: how much of the frame is shown, and with how many pixels.
        on_photo: called after each.

    Raises:
        InputError: for a view of more pixels than the frame has.
    """
    if not 8 <= view.size <= view.crop:
        raise InputError(f"size: {view.size} found, 8 to {view.crop} is allowed")
    size = view.size
    images, masks, names, hashes, skipped = [], [], [], [], []
    for photo in photos:
        try:
            image, mask = _canonical(photo, view)
        except InputError as error:
            skipped.append(SkippedPhotos(photo.name, str(error)))
        else:
            images.append(image)
            masks.append(mask)
            names.append(photo.name)
            hashes.append(hashlib.sha256(photo.path.read_bytes()).hexdigest())
        if on_photo is not None:
            on_photo()
    return PhotoSet(
        torch.from_numpy(np.array(images, np.uint8).reshape(-1, 3, size, size)),
        torch.from_numpy(np.array(masks, np.uint8).reshape(-1, 1, size, size)),
        tuple(names),
        tuple(hashes),
        tuple(skipped),
    )


def _canonical(photo: Photo, view: Crop) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    pixels = read_image(photo.path, channels=3).pixels
    eyes = eye_centres(photo.points)
    image = _shown(np.moveaxis(to_canonical(pixels, eyes), -1, 0), view)
    mask = _shown(skin_mask(canonical_landmarks(photo.points))[None], view)
    mask = mask * _shown(canonical_coverage(pixels.shape[0], pixels.shape[1], eyes)[None], view)
    if not mask.any():
        raise InputError("no face in the frame: its landmarks lie outside the picture")
    return _bytes(linear_to_srgb(image)), _bytes(mask)


def _shown(planes: npt.NDArray[np.float32], view: Crop) -> npt.NDArray[np.float32]:
    shown: npt.NDArray[np.float32] = view.apply(torch.from_numpy(planes.astype(np.float32))).numpy()
    return shown


def _bytes(values: npt.NDArray[np.floating]) -> npt.NDArray[np.uint8]:
    rounded: npt.NDArray[np.uint8] = np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8)
    return rounded


def _parts(folder: Path) -> list[Path]:
    """The folder itself if it holds photographs, else those of its subfolders that do."""
    subfolders = sorted(path for path in folder.iterdir() if path.is_dir() and _pictures(path))
    own = _pictures(folder)
    if own and subfolders:
        raise InputError(
            f"{folder}: photographs found in it and in {subfolders[0].name}/; give a folder of photographs "
            "or a folder of such folders"
        )
    if not own and not subfolders:
        raise InputError(f"{folder}: no photographs found; JPEG or PNG files are needed")
    return [folder] if own else subfolders


def _pictures(folder: Path) -> list[Path]:
    files = [path for path in sorted(folder.iterdir()) if path.is_file() and not path.name.startswith(".")]
    pictures = [path for path in files if path.suffix.lower() in PICTURES]
    others = [path for path in files if path.suffix.lower() not in PICTURES | _ASIDE]
    if pictures and others:
        raise InputError(
            f"{folder}: {others[0].name} found among photographs; a folder of JPEG and PNG files is needed"
        )
    return pictures


def _landmarks(folder: Path) -> dict[str, Array]:
    return read_landmarks(find_landmarks(folder))


def find_landmarks(folder: Path) -> Path:
    """The file of landmarks that lies in a folder of photographs or beside it.

    Raises:
        InputError: if there is none.
    """
    choices = [folder / "landmarks.npz", folder.with_name(f"{folder.name}_landmarks.npz")]
    path = next((choice for choice in choices if choice.is_file()), None)
    if path is None:
        raise InputError(f"{folder}: no landmarks found; {choices[0]} or {choices[1]} is needed")
    return path


def read_landmarks(path: Path) -> dict[str, Array]:
    """Landmarks (68, 2) by file name of an ``.npz`` with ``files`` (N names) and ``points`` (N, 68, 2).

    Raises:
        InputError: if it is missing, damaged or holds something else.
    """
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            files, points = file["files"], file["points"].astype(np.float64)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(
            f"{path}: no landmarks ({error}); files (N,) and points (N, 68, 2) are needed"
        ) from error
    if points.shape != (len(files), COUNT, 2):
        raise InputError(f"{path}: points of shape {points.shape} found, ({len(files)}, {COUNT}, 2) expected")
    return dict(zip((str(name) for name in files), points, strict=True))


def _unusable(points: Array | None) -> str:
    """Why a photograph cannot be used; empty if it can."""
    if points is None:
        return "its name is not among the landmarks"
    if not np.isfinite(points).all():
        return "its landmarks are not finite, as where no face was found"
    (xl, _), (xr, _) = eye_centres(points)
    return "" if xr - xl >= 4 else "its eyes are less than 4 pixels apart"


#: Lights that rendered photographs are taken under, and the seed that sets them apart from training's.
_LIGHTS: Final = 256
_SEED: Final = 7_000_001

Load = Callable[[Sequence[str], Crop], PhotoSet]


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
        InputError: for an unusable folder.
    """
    listed, skipped = list_photos(folder)
    train, held = split_holdout(listed, held_back)
    known = {photo.name: photo for photo in listed}

    def load(names: Sequence[str], view: Crop) -> PhotoSet:
        return load_photos([known[name] for name in names], view)

    return PhotoSource(
        tuple(photo.name for photo in train[:most]),
        tuple(photo.name for photo in held),
        {item.name: item.reason for item in skipped},
        load,
    )


def rendered_stand_ins(
    train: Faces, held: Faces, augmentation: Augmentation, *, held_back: int, most: int
) -> PhotoSource:
    """Rendered faces photographed under lights of their own, as 8-bit pictures: photographs in form only.

    Args:
        train, held: faces of one size, those that networks learn from and those kept for measuring.
        augmentation: how training images vary; these vary likewise.
        held_back: pictures to measure on, of held faces.
        most: pictures to learn from.
    """
    bank = draw_lights(augmentation.light, min(augmentation.num_lights, _LIGHTS), _SEED)
    parts = {
        kind: RelitFaces(faces, 1, replace(augmentation, num_val=0), _SEED, bank)
        for kind, faces in (("train", train), ("held", held))
    }

    def load(names: Sequence[str], view: Crop) -> PhotoSet:
        found = Crop(train.normal.shape[-1], augmentation.crop)
        if view != found:
            raise InputError(f"{view} found, the rendered photographs are {found}")
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
    shown = (linear_to_srgb_torch(images.clamp(0, 1)) * 255).round().to(torch.uint8)
    hashes = [hashlib.sha256(image.numpy().tobytes()).hexdigest() for image in shown]
    return PhotoSet(shown, (masks * 255).round().to(torch.uint8), tuple(names), tuple(hashes), ())
