"""Photographs of a face database: what each shows, and how it comes to the canonical frame."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.conventions import EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT, FACE_SIZE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.image_io import read_image, read_samples
from sfsnet_dr.data.alignment import (
    Eyes,
    canonical_coverage,
    canonical_landmarks,
    face_ellipse_mask,
    resample_to_canonical,
    skin_mask,
)
from sfsnet_dr.data.photos import SkippedPhotos

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

#: Half axes (pixels) of what is left out about each eye where no landmarks say more.
_EYE_SIZE: Final = (9.0, 5.0)

CANONICAL_EYES: Final[Eyes] = (EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT)


@dataclass(frozen=True, eq=False)
class FacePhoto:
    """One photograph.

    Attributes:
        name: its path below the database's folder.
        path: the file.
        subject: whom it shows; never empty.
        capture: photographs of one capture show the same face in the same pose under different lights.
        eyes: eye centres in its pixels.
        light: name of its light within the database, empty if unknown.
        direction: unit vector toward that light in the camera frame, None if unknown.
        points: 68 landmarks (68, 2) in its pixels, None if unknown.
        part: ``train``, ``val`` or ``test`` where the database says so, else empty.
    """

    name: str
    path: Path
    subject: str
    capture: str
    eyes: Eyes
    light: str = ""
    direction: tuple[float, float, float] | None = None
    points: Array | None = None
    part: str = ""


@dataclass(frozen=True, eq=False)
class Listing:
    """The photographs of a database, in the order of their names, and what else was found in its folder.

    Attributes:
        database: its name, such as ``yale-b``.
        folder: where it lies.
        photos: usable ones; at least one.
        skipped: files that cannot be used, with the reason.
        linear: whether the files hold linear light instead of sRGB-encoded values; 8 bits are then needed.
        calibrated_by: the network with whose help the directions were found; empty where the database tells
            them.
    """

    database: str
    folder: Path
    photos: tuple[FacePhoto, ...]
    skipped: tuple[SkippedPhotos, ...]
    linear: bool = False
    calibrated_by: str = ""

    def __post_init__(self) -> None:
        if not self.photos:
            first = next((f"{each.name}: {each.reason}" for each in self.skipped), "")
            why = first or "`sfsnet-dr data check --help` says where its layout is described"
            raise InputError(f"{self.folder}: no photograph of {self.database} found; {why}")

    @property
    def subjects(self) -> tuple[str, ...]:
        """Who is in it, in order."""
        return tuple(sorted({photo.subject for photo in self.photos}))

    def first_subjects(self, count: int) -> Listing:
        """The same with its first subjects only."""
        chosen = self.subjects[:count]
        return replace(self, photos=tuple(photo for photo in self.photos if photo.subject in chosen))

    def captures(self) -> dict[str, list[FacePhoto]]:
        """Photographs by capture."""
        groups = defaultdict(list)
        for photo in self.photos:
            groups[photo.capture].append(photo)
        return dict(sorted(groups.items()))


class CanonicalFace(NamedTuple):
    """A photograph in the canonical frame.

    Args:
        image: linear, (128, 128, 3); equal channels for a grey file.
        mask: share of each pixel that is face skin inside the photograph, (128, 128).
        grey: whether the file has one channel.
        seen: share of each pixel that the photograph covers, (128, 128).
    """

    image: Image
    mask: Image
    grey: bool
    seen: Image


def read_face(photo: FacePhoto, linear: bool) -> CanonicalFace:
    """Read a photograph and bring it to the canonical frame.

    Args:
        photo: which.
        linear: see ``Listing``.

    Raises:
        InputError: if the file is broken, is linear with other than 8 bits, or its face lies outside of it.
    """
    if linear:
        pixels, bits = read_samples(photo.path)
        if bits != 8:
            raise InputError(f"{photo.path}: {bits} bits a sample found, 8 are needed")
    else:
        pixels = read_image(photo.path).pixels
    grey = pixels.shape[2] == 1
    known = photo.points
    skin = frontal_mask() if known is None else skin_mask(canonical_landmarks(known))
    if pixels.shape[:2] == (FACE_SIZE, FACE_SIZE) and photo.eyes == CANONICAL_EYES:
        image, seen = pixels, np.ones((FACE_SIZE, FACE_SIZE), np.float32)
    else:
        image = resample_to_canonical(pixels, photo.eyes)
        seen = canonical_coverage(pixels.shape[0], pixels.shape[1], photo.eyes)
    mask = skin * seen
    if not (mask > 0.5).any():
        raise InputError(
            f"{photo.path}: no face in the frame, its eyes or landmarks lie at the picture's edge"
        )
    return CanonicalFace(np.repeat(image, 3, axis=2) if grey else image, mask, grey, seen)


def frontal_mask() -> Image:
    """Skin of a frontal face of which only the eyes are known: an ellipse without the eyes, (128, 128)."""
    fine = (np.arange(FACE_SIZE) + 0.5)[None, :], (np.arange(FACE_SIZE) + 0.5)[:, None]
    mask = face_ellipse_mask().copy()
    for x, y in CANONICAL_EYES:
        mask[((fine[0] - x) / _EYE_SIZE[0]) ** 2 + ((fine[1] - y) / _EYE_SIZE[1]) ** 2 < 1] = 0
    return mask


def heading(azimuth: float, elevation: float) -> tuple[float, float, float]:
    """Direction toward a light at an azimuth (positive: from the image's left) and elevation, degrees."""
    a, e = np.radians(azimuth), np.radians(elevation)
    return float(-np.sin(a) * np.cos(e)), float(np.sin(e)), float(np.cos(a) * np.cos(e))


def need_folder(folder: Path | str) -> Path:
    """The folder as a path.

    Raises:
        InputError: if there is none.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; the folder of a face database is needed")
    return folder


def sort_photos(photos: Iterable[FacePhoto]) -> tuple[FacePhoto, ...]:
    """Photographs by name."""
    return tuple(sorted(photos, key=lambda photo: photo.name))
