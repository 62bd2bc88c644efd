"""From the name of a kind of data and its folder to photographs that methods can be measured on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sfsnet_dr.core.errors import InputError, nearest
from sfsnet_dr.data.databases.base import Listing
from sfsnet_dr.data.databases.registry import open_database, recognise_database
from sfsnet_dr.data.normal_labels import load_normal_labels, read_index
from sfsnet_dr.experiments.evaluation.labelled import FEW, labelled_samples
from sfsnet_dr.experiments.evaluation.samples import Collection
from sfsnet_dr.experiments.evaluation.synthetic import synthetic_samples
from sfsnet_dr.experiments.evaluation.unlabelled import photograph_samples, under_lights
from sfsnet_dr.experiments.photometric_stereo.captures import read_image_sets
from sfsnet_dr.experiments.photometric_stereo.run import compute_normal_labels
from sfsnet_dr.report.console import progress_bar

#: Kinds of data, and what is measured on each.
KINDS: Final = {
    "yale-b": "Extended Yale B: everything, the truth by photometric stereo",
    "photoface": "Photoface: likewise",
    "labels": "what `sfsnet-dr photometric-stereo` wrote: likewise, without doing it again",
    "lights": "a database with known lights: their classification and direction alone",
    "celeba": "CelebA's test part: reconstruction",
    "folder": "photographs with landmarks: reconstruction",
    "synthetic": "rendered faces held back from training: everything",
}

#: What is left of the data for a quick look.
_QUICK_SUBJECTS, _QUICK_LIGHTS, _QUICK_MOST = 4, 4, 60


@dataclass(frozen=True)
class Amount:
    """How much of the data is measured.

    Attributes:
        most: photographs of celeba, folder or synthetic.
        quick: four subjects, the 19 lights and every fourth of the others, 60 photographs.
        database: whose lights ``lights`` classifies.
    """

    most: int = 300
    quick: bool = False
    database: str = "yale-b"


def collect_samples(kind: str, folders: Sequence[Path], amount: Amount) -> Collection:
    """Read the data, with a bar on standard error.

    Args:
        kind: of ``KINDS``.
        folders: one, or several of rendered faces.
        amount: how much of it.

    Raises:
        InputError: for an unknown kind, or a folder that holds nothing of that kind.
    """
    if kind not in KINDS:
        raise InputError(f"{kind}: neither a folder nor a kind of data; {nearest(kind, KINDS)}")
    if len(folders) != 1 and kind != "synthetic":
        raise InputError(f"{kind}: {len(folders)} folders found, one is needed")
    if amount.most < 1:
        raise InputError(f"--max-images: {amount.most} photographs found, at least 1 is needed")
    most = min(amount.most, _QUICK_MOST) if amount.quick else amount.most
    if kind == "synthetic":
        with progress_bar("photographing rendered faces", most) as advance:
            return synthetic_samples(folders, most, advance)
    if kind == "labels":
        index, faces = read_index(folders[0]), load_normal_labels(folders[0])
        chosen = sorted({face.subject for face in faces})[: _QUICK_SUBJECTS if amount.quick else None]
        faces = [face for face in faces if face.subject in chosen]
        names = {name for face in faces for name in face.lights}
        lights = _some(names, index["database"], amount.quick)
        return labelled_samples(index["database"], faces, index["skipped"], lights)
    listing = _open(amount.database if kind == "lights" else kind, folders[0])
    if kind in ("celeba", "folder"):
        with progress_bar("reading photographs", min(most, len(listing.photos))) as advance:
            return photograph_samples(listing, most, advance)
    if amount.quick:
        listing = listing.first_subjects(_QUICK_SUBJECTS)
    lights = _some({photo.light for photo in listing.photos}, listing.database, amount.quick)
    if kind == "lights":
        with progress_bar("reading photographs", len(listing.photos)) as advance:
            return under_lights(listing, lights, advance)
    with progress_bar("reading photographs", len(listing.captures())) as advance:
        read = read_image_sets(listing, advance)
    with progress_bar("photometric stereo", len(read.faces)) as advance:
        found = compute_normal_labels(read, halves=False, on_capture=advance)
    return labelled_samples(kind, found.labels, found.skipped, lights, listing)


def _open(kind: str, folder: Path) -> Listing:
    """The listing, or one line that says what the folder seems to be instead."""
    try:
        return open_database(kind, folder)
    except InputError as error:
        other = recognise_database(folder)
        if other in (None, kind) or str(folder) not in str(error):
            raise
        raise InputError(f"{folder}: holds no photographs of {kind}; it looks like {other}") from error


def _some(lights: set[str], database: str, quick: bool) -> list[str] | None:
    """The lights of the 19-way classification and every fourth of the others; None for all."""
    others = sorted(lights.difference(FEW.get(database, ())))
    if not quick or len(others) < 4 * _QUICK_LIGHTS:
        return None
    return [*FEW.get(database, ()), *others[::_QUICK_LIGHTS]]
