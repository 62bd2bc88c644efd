"""Faces that were photographed under many lamps, read once for all that is found from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.databases.base import FacePhoto, Listing, read_face

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ImageSet:
    """One face in the canonical frame.

    Attributes:
        name: of the capture.
        photos: N photographs.
        images: linear, (N, S, S, C), C is 1 for grey files.
        mask: skin that all photographs show, (S, S).
    """

    name: str
    photos: tuple[FacePhoto, ...]
    images: Array
    mask: Array

    @property
    def directions(self) -> Array:
        """Toward the lamps, (N, 3); NaN where that is not known."""
        unknown = (np.nan,) * 3
        return np.array([photo.direction or unknown for photo in self.photos])

    @property
    def lamps(self) -> tuple[str, ...]:
        """Names of the lamps."""
        return tuple(photo.light for photo in self.photos)

    def only(self, chosen: Sequence[bool]) -> ImageSet:
        """Some of its photographs."""
        photos = tuple(photo for photo, keep in zip(self.photos, chosen, strict=True) if keep)
        return ImageSet(self.name, photos, self.images[np.array(chosen, bool)], self.mask)


@dataclass(frozen=True, eq=False)
class ImageSets:
    """All captures of a database that can be read.

    Attributes:
        listing: what was read.
        faces: the captures.
        skipped: photographs and captures that are not in it, with the reason.
    """

    listing: Listing
    faces: tuple[ImageSet, ...]
    skipped: dict[str, str]


def read_image_sets(listing: Listing, on_capture: Callable[[], Any] = lambda: None) -> ImageSets:
    """Bring all photographs to the canonical frame; those that cannot be read are told in ``skipped``.

    Args:
        listing: a database.
        on_capture: called after each.
    """
    skipped = {item.name: item.reason for item in listing.skipped}
    faces = []
    for name, photos in listing.captures().items():
        try:
            faces.append(_read(name, photos, listing.linear, skipped))
        except InputError as error:
            skipped[name] = str(error)
        on_capture()
    return ImageSets(listing, tuple(faces), skipped)


def _read(name: str, photos: Sequence[FacePhoto], linear: bool, skipped: dict[str, str]) -> ImageSet:
    used, images, masks = [], [], []
    for photo in photos:
        try:
            face = read_face(photo, linear)
        except InputError as error:
            skipped[photo.name] = str(error)
            continue
        used.append(photo)
        images.append(face.image[..., :1] if face.grey else face.image)
        masks.append(face.mask)
    if not used:
        raise InputError("none of its photographs can be used")
    if len({image.shape for image in images}) > 1:
        raise InputError("grey and coloured pictures are mixed")
    return ImageSet(name, tuple(used), np.array(images, np.float64), np.min(masks, axis=0).astype(np.float64))
