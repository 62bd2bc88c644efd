"""The face databases by name, and what a folder of one holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sfsnet_dr.core.errors import InputError, nearest
from sfsnet_dr.data.databases import celeba, multipie, photoface, yale_b
from sfsnet_dr.data.databases import folder as image_folder
from sfsnet_dr.data.databases.base import Listing, read_face
from sfsnet_dr.data.manifest import NAME as MANIFEST
from sfsnet_dr.data.normal_labels import INDEX
from sfsnet_dr.data.photos import SkippedPhotos

DATABASES: Final[dict[str, Callable[[Path | str], Listing]]] = {
    yale_b.NAME: yale_b.list_yale_b,
    photoface.NAME: photoface.list_photoface,
    multipie.NAME: multipie.list_multipie,
    celeba.NAME: celeba.list_celeba,
    image_folder.NAME: image_folder.list_folder,
}

#: What a folder of each kind has at its top, as patterns; the first kind that fits is the folder's.
_SIGNS: Final[dict[str, tuple[str, ...]]] = {
    "labels": (INDEX,),
    "synthetic": (MANIFEST,),
    yale_b.NAME: ("yaleB[0-9][0-9]", "yaleB[0-9][0-9]_P*"),
    celeba.NAME: ("list_eval_partition.txt", "Eval/list_eval_partition.txt"),
    multipie.NAME: ("session[0-9][0-9]",),
    photoface.NAME: ("LightSource.m", "*/LightSource.m", "*/*/LightSource.m"),
    image_folder.NAME: ("landmarks.npz", "*_landmarks.npz", "*/landmarks.npz"),
}

#: Lights from which photometric stereo can be done.
FEWEST_LIGHTS: Final = 4


def open_database(name: str, folder: Path | str) -> Listing:
    """List a folder as the database of that name.

    Raises:
        InputError: for an unknown name, or a folder that holds no photograph of it.
    """
    if name not in DATABASES:
        raise InputError(f"database: {name!r} found; {nearest(name, DATABASES)}")
    return DATABASES[name](folder)


def recognise_database(folder: Path | str) -> str | None:
    """Which database a folder looks like; ``synthetic`` for rendered faces, ``labels`` for labelled ones.

    None for anything else, such as pictures without landmarks.
    """
    folder = Path(folder)
    for name, patterns in _SIGNS.items():
        if any(next(folder.glob(pattern), None) is not None for pattern in patterns):
            return name
    beside = folder.with_name(f"{folder.name}_landmarks.npz")
    return image_folder.NAME if folder.is_dir() and beside.is_file() else None


@dataclass(frozen=True)
class DatabaseCounts:
    """What a folder holds.

    Attributes:
        counts: by what is counted: photographs, subjects, captures, lights, decoded, skipped, ...
        skipped: files that cannot be used, those found broken by decoding included.
        few_lights: captures with fewer than four usable lights.
    """

    counts: dict[str, int]
    skipped: tuple[SkippedPhotos, ...]
    few_lights: tuple[str, ...]


def check_database(
    name: str, folder: Path | str, decode: int = 200, on_photo: Callable[[], object] = lambda: None
) -> DatabaseCounts:
    """List a database and decode some of its photographs, spread evenly.

    Args:
        name: see ``DATABASES``.
        folder: its folder.
        decode: how many photographs are decoded and brought to the canonical frame; 0 for none.
        on_photo: called after each.

    Raises:
        InputError: see ``open_database``.
    """
    listing = open_database(name, folder)
    broken = []
    step = max(1, len(listing.photos) // decode) if decode else 0
    chosen = listing.photos[::step][:decode] if decode else ()
    for photo in chosen:
        try:
            read_face(photo, listing.linear)
        except InputError as error:
            broken.append(SkippedPhotos(photo.name, str(error)))
        on_photo()
    known = {n: [p for p in photos if p.direction is not None] for n, photos in listing.captures().items()}
    few = tuple(n for n, photos in known.items() if 0 < len(photos) < FEWEST_LIGHTS)
    skipped = (*listing.skipped, *broken)
    counts = {
        "photographs": len(listing.photos),
        "subjects": len(listing.subjects),
        "captures": len(known),
        "lights": len({photo.light for photo in listing.photos if photo.light}),
        "decoded": len(chosen) - len(broken),
        "skipped": len(skipped),
        "captures_with_few_lights": len(few),
    }
    parts = Counter(photo.part for photo in listing.photos if photo.part)
    return DatabaseCounts(counts | {f"part_{part}": parts[part] for part in sorted(parts)}, skipped, few)
