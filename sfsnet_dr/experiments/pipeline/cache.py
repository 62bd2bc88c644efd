"""Faces, labels and networks that are made once and kept; what was stopped is continued."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from sfsnet_dr.core import files
from sfsnet_dr.core.config import as_dict
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.provenance import sha256
from sfsnet_dr.data.generate import synthesize
from sfsnet_dr.data.manifest import NAME as FACES_MANIFEST
from sfsnet_dr.data.manifest import Manifest
from sfsnet_dr.data.normal_labels import INDEX as SURFACES_INDEX
from sfsnet_dr.data.photos import PhotoSource
from sfsnet_dr.data.pseudo_labels import MANIFEST as LABELS_MANIFEST
from sfsnet_dr.data.pseudo_labels import Encoding
from sfsnet_dr.report.console import progress_bar
from sfsnet_dr.scene.spec import SceneSpec
from sfsnet_dr.train.checkpoint import find_differences
from sfsnet_dr.train.config import Recipe
from sfsnet_dr.train.pseudo_label import pseudo_label
from sfsnet_dr.train.run import CHECKPOINT, WEIGHTS
from sfsnet_dr.train.trainer import train

#: What a finished network was made from.
DONE: Final = "stage.json"

Tell = Callable[[str], None]


def render_missing(
    folder: Path,
    scene: SceneSpec,
    count: int,
    tell: Tell,
    *,
    seed: int = 0,
    on_face: Callable[[], object] = lambda: None,
) -> None:
    """Render the faces ``seed .. seed + count - 1`` that are not there yet.

    Args:
        folder: of the bundles.
        scene: of all of them.
        count: how many there shall be.
        tell: called with what is done.
        seed: of the first.
        on_face: called after each that is rendered.

    Raises:
        InputError: for a folder with faces of another scene.
    """
    wanted = range(seed, seed + count)
    listed = Manifest(folder).finished_seeds() if (folder / FACES_MANIFEST).exists() else set()
    there = len(listed.intersection(wanted))
    tell("rendered before" if there == count else f"rendering {count - there}")
    if there < count:
        with progress_bar("rendering faces", count, there) as advance:

            def after(_: int) -> None:
                on_face()
                advance()

            synthesize(folder, scene, count, seed=seed, resume=folder.exists(), on_face=after)


def label_photographs(
    source: PhotoSource, weights: Path, folder: Path, values: Encoding | None = None
) -> None:
    """Let a network label photographs, with a bar; see ``fit.pseudo_label``."""
    with progress_bar("labelling photographs", len(source.train)) as advance:

        def on_shard(count: int) -> None:
            for _ in range(count):
                advance()

        pseudo_label(source, weights, folder, values=values, on_shard=on_shard)


def train_once(
    recipe: Recipe,
    faces: Sequence[Path],
    folder: Path,
    tell: Tell,
    *,
    labels: Path | None = None,
    surfaces: Path | None = None,
    start: Path | None = None,
) -> None:
    """Train a network unless that was done, and note what from.

    Args:
        recipe: of the network.
        faces: folders of bundles.
        folder: of the network.
        tell: called with what is done.
        labels: pseudo-labels to learn from too.
        surfaces: labels by photometric stereo to learn from too.
        start: weights to begin with.

    Raises:
        InputError: if the folder holds a network that was made from something else.
        RunError: if training failed or was told to stop; the same call goes on.
    """
    wanted: dict[str, Any] = {
        "recipe": as_dict(recipe),
        "faces": [sha256(part / FACES_MANIFEST) for part in faces],
        "labels": None if labels is None else sha256(labels / LABELS_MANIFEST),
    }
    if surfaces is not None and start is not None:
        wanted |= {"surfaces": sha256(surfaces / SURFACES_INDEX), "start": sha256(start)}
    note = folder / DONE
    if note.is_file() and (folder / WEIGHTS).is_file():
        for where, found, asked in find_differences(json.loads(note.read_text(encoding="utf-8")), wanted):
            raise InputError(
                f"{note}: {where} = {found!r} found, {asked!r} asked for; choose another --out, or remove "
                f"{folder} to train it anew"
            )
        tell("done before")
        return
    resume = (folder / CHECKPOINT).is_file()
    tell("going on" if resume else f"{recipe.steps} steps")
    train(recipe, faces, folder, labels=labels, surfaces=surfaces, resume=resume, start=start)
    files.write_text(note, json.dumps(wanted, indent=1, sort_keys=True) + "\n")
