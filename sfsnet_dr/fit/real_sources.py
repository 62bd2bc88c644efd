"""The real faces that a recipe asks for, opened and checked before anything else is done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import torch

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.base.conventions import FACE_SIZE
from sfsnet_dr.data.mixture import RealFaces
from sfsnet_dr.data.pseudo_labels import load_pseudo_labels
from sfsnet_dr.data.real_batch import RealSource, RealTogether
from sfsnet_dr.data.surface_faces import IdentitySplit, SurfaceFaces, load_learnt, read_split
from sfsnet_dr.fit.recipe import Recipe
from sfsnet_dr.model.weights import read_metadata


class Unopened(NamedTuple):
    """A source of real faces that a recipe asks for.

    Attributes:
        images: of it in a mini-batch.
        open: makes its batches on a device.
    """

    images: int
    open: Callable[[torch.device], RealSource]


@dataclass(frozen=True)
class RealPart:
    """What a recipe takes of real faces, ready to be opened.

    Attributes:
        sources: photographs with pseudo-labels, then captures; empty where there is none.
        metadata: what the weights should tell about them.
    """

    sources: tuple[Unopened, ...] = ()
    metadata: dict[str, Any] = field(default_factory=dict)

    @property
    def counts(self) -> tuple[int, ...]:
        """Images of each source in a mini-batch."""
        return tuple(source.images for source in self.sources)

    def open(self, device: torch.device) -> RealTogether:
        """The batches of all sources on a device; there must be one."""
        return RealTogether([source.open(device) for source in self.sources])


def real_part(
    recipe: Recipe, labels: Path | str | None, surfaces: Path | str | None, start: Path | None
) -> RealPart:
    """Photographs with pseudo-labels, faces with labels by photometric stereo, both or none.

    Raises:
        BadInput: if folders and the recipe's shares do not belong together, for unusable labels, or if
            ``start`` has learnt from somebody who is to be held back.
    """
    _together("real.share", recipe.real.share, labels, "--labels DIR (see `sfsnet-dr pseudo-label`)")
    _together(
        "surfaces.share",
        recipe.surfaces.share,
        surfaces,
        "--surfaces DIR (see `sfsnet-dr photometric-stereo`)",
    )
    sources: list[Unopened] = []
    metadata = {}
    if labels is not None:
        found, photographs = load_pseudo_labels(labels), recipe.real.count(recipe.batch_size)
        _check_crop(labels, int(found.spec.get("crop", FACE_SIZE)), recipe.data.crop)
        sources.append(
            Unopened(
                photographs, lambda device: RealFaces(found.to(device), photographs, recipe.real, recipe.seed)
            )
        )
    if surfaces is not None:
        faces, split = load_learnt(surfaces, recipe.surfaces, recipe.data.view)
        captures = recipe.surfaces.count(recipe.batch_size)
        _check_start(start, split)
        sources.append(
            Unopened(
                captures,
                lambda device: SurfaceFaces(faces, captures, recipe.surfaces, recipe.seed, device),
            )
        )
        metadata = {"surfaces": split.metadata}
    return RealPart(tuple(sources), metadata)


def _together(key: str, share: float, folder: Path | str | None, option: str) -> None:
    if (folder is None) != (share == 0):
        found = "no folder of labels" if folder is None else f"the labels of {folder}"
        raise BadInput(
            f"{key}: {share:g} in the recipe and {found} found; a share above 0 and {option} belong together"
        )


def _check_crop(labels: Path | str, found: int, wanted: int) -> None:
    """Refuse labels of photographs that show more or less of the frame than the rendered faces do."""
    if found != wanted:
        raise BadInput(
            f"{labels}: labels of {found} of the frame's {FACE_SIZE} pixels found, data.crop {wanted} is "
            "needed; label the photographs with a network of that crop"
        )


def _check_start(start: Path | None, split: IdentitySplit) -> None:
    """Refuse weights that have seen whom the split holds back."""
    before = None if start is None else read_split(read_metadata(start))
    if before is None or before.database != split.database:
        return
    seen = sorted(set(before.learnt) & set(split.held_back))
    if seen:
        raise BadInput(f"{start}: has learnt from {', '.join(seen)}, whom this fold holds back")
