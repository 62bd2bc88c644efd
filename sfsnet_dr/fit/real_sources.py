"""The real faces that a recipe asks for, opened and checked before anything else is done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.base.conventions import FACE_SIZE
from sfsnet_dr.data.mixture import RealFaces, RealSource
from sfsnet_dr.data.pseudo_labels import load_pseudo_labels
from sfsnet_dr.data.surface_faces import IdentitySplit, SurfaceFaces, load_learnt, read_split
from sfsnet_dr.fit.recipe import Recipe
from sfsnet_dr.model.weights import read_metadata


@dataclass(frozen=True)
class RealKind:
    """Real faces in mini-batches.

    Attributes:
        count: of each mini-batch.
        open: their batches on a device; None where ``count`` is 0.
        metadata: what the weights should tell about them.
    """

    count: int = 0
    open: Callable[[torch.device], RealSource] | None = None
    metadata: dict[str, Any] = field(default_factory=dict)


def real_kind(
    recipe: Recipe, labels: Path | str | None, surfaces: Path | str | None, start: Path | None
) -> RealKind:
    """Photographs with pseudo-labels, faces with labels by photometric stereo, or none.

    Raises:
        BadInput: if folders and the recipe's shares do not belong together, for unusable labels, or if
            ``start`` has learnt from somebody who is to be held back.
    """
    photographs, captures = recipe.real.count(recipe.batch_size), recipe.surfaces.count(recipe.batch_size)
    _together("real.share", recipe.real.share, labels, "--labels DIR (see `sfsnet-dr pseudo-label`)")
    _together(
        "surfaces.share",
        recipe.surfaces.share,
        surfaces,
        "--surfaces DIR (see `sfsnet-dr photometric-stereo`)",
    )
    if labels is not None:
        found = load_pseudo_labels(labels)
        _check_crop(labels, int(found.spec.get("crop", FACE_SIZE)), recipe.data.crop)
        return RealKind(
            photographs, lambda device: RealFaces(found.to(device), photographs, recipe.real, recipe.seed)
        )
    if surfaces is not None:
        faces, split = load_learnt(surfaces, recipe.surfaces, recipe.data.view)
        _check_start(start, split)
        return RealKind(
            captures,
            lambda device: SurfaceFaces(faces, captures, recipe.surfaces, recipe.seed, device),
            {"surfaces": split.metadata},
        )
    return RealKind()


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
