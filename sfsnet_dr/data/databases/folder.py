"""A plain folder of pictures of faces: with 68 landmarks each, with eye centres each, or canonical already.

Landmarks come as ``data.photo_set`` has them. Without any, a picture's eye centres stand in the .toml of its
name (``data.photograph``), or it is 128 x 128 in the canonical frame.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from sfsnet_dr.core.conventions import FACE_SIZE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.image_io import read_image
from sfsnet_dr.data.alignment import Eyes, eye_centres, read_eyes, side_file
from sfsnet_dr.data.databases.base import CANONICAL_EYES, FacePhoto, Listing, need_folder, sort_photos
from sfsnet_dr.data.photos import PICTURES, SkippedPhotos, list_photos

NAME: Final = "folder"


def list_folder(folder: Path | str) -> Listing:
    """All pictures of a folder; each is a subject of its own.

    Raises:
        InputError: if the folder is missing, or none of its pictures can be used.
    """
    folder = need_folder(folder)
    if _has_landmarks(folder):
        listed, skipped = list_photos(folder)
        photos = [
            FacePhoto(p.name, p.path, p.name, p.name, eye_centres(p.points), points=p.points) for p in listed
        ]
        return Listing(NAME, folder, sort_photos(photos), tuple(skipped))
    photos, skipped = [], []
    for path in sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURES):
        try:
            photos.append(FacePhoto(path.name, path, path.name, path.name, _eyes(path)))
        except InputError as error:
            skipped.append(SkippedPhotos(path.name, str(error)))
    return Listing(NAME, folder, sort_photos(photos), tuple(skipped))


def _has_landmarks(folder: Path) -> bool:
    beside = folder.with_name(f"{folder.name}_landmarks.npz")
    return (folder / "landmarks.npz").is_file() or beside.is_file() or any(folder.glob("*_landmarks.npz"))


def _eyes(path: Path) -> Eyes:
    if side_file(path).is_file():
        return read_eyes(side_file(path))
    height, width, _ = read_image(path).pixels.shape
    if (height, width) != (FACE_SIZE, FACE_SIZE):
        raise InputError(
            f"{width} x {height} pixels and no eye centres; {side_file(path).name} beside it, landmarks.npz, "
            f"or {FACE_SIZE} x {FACE_SIZE} in the canonical frame is needed"
        )
    return CANONICAL_EYES
