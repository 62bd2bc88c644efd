"""The real faces that a recipe asks for, opened and checked before anything else is done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch

from sfsnet_dr.core.conventions import FACE_SIZE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.mixed_batch import ConcatSource, RealFaces, RealSource
from sfsnet_dr.data.normal_dataset import IdentitySplit, NormalLabelFaces, load_training_subjects, read_split
from sfsnet_dr.data.pseudo_labels import load_pseudo_labels
from sfsnet_dr.models.weights import read_metadata
from sfsnet_dr.train.config import Recipe


class SourceConfig(NamedTuple):
    """A source of real faces that a recipe asks for.

    Attributes:
        images: of it in a mini-batch.
        open: makes its batches on a device.
    """

    images: int
    open: Callable[[torch.device], RealSource]


@dataclass(frozen=True)
class RealSources:
    """What a recipe takes of real faces, ready to be opened.

    Attributes:
        sources: photographs with pseudo-labels, then captures; empty where there is none.
        metadata: what the weights should tell about them.
    """

    sources: tuple[SourceConfig, ...] = ()
    metadata: dict[str, Any] = field(default_factory=dict)

    @property
    def counts(self) -> tuple[int, ...]:
        """Images of each source in a mini-batch."""
        return tuple(source.images for source in self.sources)

    def open(self, device: torch.device) -> ConcatSource:
        """The batches of all sources on a device; there must be one."""
        return ConcatSource([source.open(device) for source in self.sources])


def configure_sources(
    recipe: Recipe, labels: Path | str | None, surfaces: Path | str | None, start: Path | None
) -> RealSources:
    """Photographs with pseudo-labels, faces with labels by photometric stereo, both or none.

    Raises:
        InputError: if folders and the recipe's shares do not belong together, for unusable labels, or if
            ``start`` knows of somebody what it must not, see ``_checked_split``.
    """
    _together(
        "real.batch_fraction",
        recipe.real.batch_fraction,
        labels,
        "--pseudo-labels DIR (see `sfsnet-dr pseudo-label`)",
    )
    _together(
        "normal_labels.batch_fraction",
        recipe.normal_labels.batch_fraction,
        surfaces,
        "--normal-labels DIR (see `sfsnet-dr photometric-stereo`)",
    )
    sources: list[SourceConfig] = []
    metadata = {}
    if labels is not None:
        found, photographs = load_pseudo_labels(labels), recipe.real.count(recipe.batch_size)
        _check_crop(labels, int(found.spec.get("crop", FACE_SIZE)), recipe.data.crop)
        sources.append(
            SourceConfig(
                photographs, lambda device: RealFaces(found.to(device), photographs, recipe.real, recipe.seed)
            )
        )
    if surfaces is not None:
        faces, dealt = load_training_subjects(surfaces, recipe.normal_labels, recipe.data.view)
        split = _checked_split(dealt, start)
        captures = recipe.normal_labels.count(recipe.batch_size)
        sources.append(
            SourceConfig(
                captures,
                lambda device: NormalLabelFaces(faces, captures, recipe.normal_labels, recipe.seed, device),
            )
        )
        metadata = {"normal_labels": split.metadata}
    return RealSources(tuple(sources), metadata)


def _together(key: str, share: float, folder: Path | str | None, option: str) -> None:
    if (folder is None) != (share == 0):
        found = "no folder of labels" if folder is None else f"the labels of {folder}"
        raise InputError(
            f"{key}: {share:g} in the recipe and {found} found; a share above 0 and {option} belong together"
        )


def _check_crop(labels: Path | str, found: int, wanted: int) -> None:
    """Refuse labels of photographs that show more or less of the frame than the rendered faces do."""
    if found != wanted:
        raise InputError(
            f"{labels}: labels of {found} of the frame's {FACE_SIZE} pixels found, data.crop {wanted} is "
            "needed; label the photographs with a network of that crop"
        )


def _checked_split(split: IdentitySplit, start: Path | None) -> IdentitySplit:
    """Return the split with the held-out subjects whose images the initial weights have seen without labels.

    Images without labels may have been learnt from before ground-truth labels of other subjects: both stay
    out of the held-out part, and the split records it. Labels calibrated by a network must not follow
    ground truth: the weights would lose the record of it.

    Raises:
        InputError: if the initial weights were trained on ground truth of a held-out subject, or on images of
            a subject that is to be unseen, or on any ground truth where the labels are calibrated.
    """
    before = None if start is None else read_split(read_metadata(start))
    if before is None or before.database != split.database:
        return split
    known = sorted((set(before.learnt) | set(before.seen)) & set(split.held_back))
    without_labels = bool(before.calibrated_by) and not split.calibrated_by
    if known and not without_labels:
        raise InputError(f"{start}: was trained on {', '.join(known)}, which this fold holds out")
    if split.calibrated_by and not before.calibrated_by:
        raise InputError(
            f"{start}: was trained on ground-truth normals of {', '.join(before.learnt)}; fine-tuning on "
            f"labels calibrated by {split.calibrated_by} would drop that record. Start from weights trained "
            "without ground truth"
        )
    return replace(split, seen=tuple(known))
