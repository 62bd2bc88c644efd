"""CelebA in its official folders: aligned pictures, partition, five landmarks, identities.

Folder: ``img_align_celeba/NNNNNN.jpg``, ``list_eval_partition.txt``, ``list_landmarks_align_celeba.txt`` and
``identity_CelebA.txt``, at the top or in ``Img``, ``Eval`` and ``Anno`` as they are distributed.
Source: Liu, Luo, Wang, Tang, ICCV 2015.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.alignment import Eyes
from sfsnet_dr.data.databases.base import FacePhoto, Listing, need_folder, sort_photos
from sfsnet_dr.data.photos import SkippedPhotos

NAME: Final = "celeba"

PARTS: Final = {"0": "train", "1": "val", "2": "test"}


def list_celeba(folder: Path | str) -> Listing:
    """All pictures that the three lists know.

    Raises:
        InputError: if the folder, a list or the pictures are missing, or a list does not parse.
    """
    folder = need_folder(folder)
    pictures = _find(folder, "img_align_celeba")
    partition = _rows(_find(folder, "list_eval_partition.txt"), 2)
    identity = _rows(_find(folder, "identity_CelebA.txt"), 2)
    landmarks = _rows(_find(folder, "list_landmarks_align_celeba.txt"), 11, header=2)
    photos, skipped = [], []
    for path in sorted(path for path in pictures.iterdir() if path.suffix == ".jpg"):
        name = path.name
        missing = [
            what
            for what, rows in (("partition", partition), ("identity", identity), ("landmarks", landmarks))
            if name not in rows
        ]
        if missing:
            skipped.append(SkippedPhotos(name, f"not in the list of its {missing[0]}"))
            continue
        subject = identity[name][0]
        photos.append(
            FacePhoto(
                name, path, subject, name, _eyes(landmarks[name]), part=PARTS.get(partition[name][0], "")
            )
        )
    return Listing(NAME, folder, sort_photos(photos), tuple(skipped))


def _find(folder: Path, name: str) -> Path:
    places = [folder / name, *(folder / part / name for part in ("Img", "Eval", "Anno"))]
    for place in places:
        if place.exists():
            return place
    raise InputError(f"{folder}: no {name}; the folder of CelebA holds it, or Img, Eval or Anno in it do")


def _rows(path: Path, columns: int, header: int = 0) -> dict[str, list[str]]:
    """File name -> the other columns of a list; the first lines of the landmarks are a count and titles."""
    rows = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines()[header:], header + 1):
        words = line.replace(",", " ").split()
        if not words:
            continue
        if len(words) != columns:
            raise InputError(f"{path}:{number}: {len(words)} columns found, {columns} expected")
        rows[words[0]] = words[1:]
    return rows


def _eyes(row: list[str]) -> Eyes:
    """Eye centres, the one on the image's left first, of ten numbers: eyes, nose, corners of the mouth."""
    numbers = [float(word) for word in row]
    first, second = sorted([(numbers[0], numbers[1]), (numbers[2], numbers[3])])
    return first, second
