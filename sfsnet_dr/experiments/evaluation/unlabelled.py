"""Photographs of a database or a folder: reconstruction alone, or the classification of known lights."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import torch

from sfsnet_dr.core.conventions import EYE_DISTANCE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.alignment import canonical_landmarks
from sfsnet_dr.data.databases import celeba
from sfsnet_dr.data.databases.base import FacePhoto, Listing, read_face
from sfsnet_dr.experiments.evaluation.labelled import FEW
from sfsnet_dr.experiments.evaluation.samples import Collection, EvaluationSample, picture_causes

PHOTOGRAPHS: Final = (
    "No truth is known but the photograph itself, which the reconstruction should give again."
)
LIGHTS: Final = "The lights are those of the rig; nothing else is asked of a method here."

_NOSE_TIP: Final = 30


def photograph_samples(
    listing: Listing, most: int, on_photo: Callable[[], object] = lambda: None
) -> Collection:
    """Photographs to reconstruct: of CelebA the test part, of a folder those that training keeps back first.

    Args:
        listing: of ``data.databases``.
        most: no more than these many, those with the lowest hashes of their names, as ``data.photo_set``
            holds photographs back: a network that was trained with the same folder and at least as many held
            back saw none of them.
        on_photo: called after each.
    """
    chosen = [p for p in listing.photos if p.part == "test"] if listing.database == celeba.NAME else []
    chosen = sorted(chosen or listing.photos, key=_rank)[:most]
    return _read(listing, chosen, PHOTOGRAPHS, on_photo)


def under_lights(
    listing: Listing, lights: Sequence[str] | None = None, on_photo: Callable[[], object] = lambda: None
) -> Collection:
    """Photographs whose lights are known, to be classified; those without a light are left out.

    Args:
        listing: of a database with named lights.
        lights: names of those that take part; all if not given.
        on_photo: called after each.

    Raises:
        InputError: if the database names no lights.
    """
    chosen = [p for p in listing.photos if p.light and (lights is None or p.light in lights)]
    if not chosen:
        raise InputError(f"{listing.folder}: no lights known of {listing.database}; yale-b, photoface and "
                       "multipie have some")  # fmt: skip
    return _read(listing, chosen, LIGHTS, on_photo)


def _rank(photo: FacePhoto) -> bytes:
    return hashlib.sha256(f"0/{photo.name}".encode()).digest()


def _read(
    listing: Listing, chosen: Sequence[FacePhoto], truth: str, on_photo: Callable[[], object]
) -> Collection:
    skipped = {item.name: item.reason for item in listing.skipped}
    shots = []
    for photo in chosen:
        try:
            shots.append(_shot(photo, listing.linear))
        except InputError as error:
            skipped[photo.name] = str(error)
        on_photo()
    return Collection(listing.database, shots, truth, FEW.get(listing.database, ()), skipped, listing)


def _shot(photo: FacePhoto, linear: bool) -> EvaluationSample:
    face = read_face(photo, linear)
    image = torch.from_numpy(np.ascontiguousarray(np.moveaxis(face.image, -1, 0)))
    mask = torch.from_numpy(face.mask[None])
    causes = picture_causes(image, mask)
    if photo.points is not None:
        points = canonical_landmarks(photo.points)
        middle = (points[36:48, 0].mean(), points[_NOSE_TIP, 0])
        causes["turned (nose's shift)"] = 100 * float(abs(middle[1] - middle[0])) / EYE_DISTANCE
    return EvaluationSample(
        name=photo.name,
        subject=photo.subject,
        capture=photo.capture,
        image=image,
        mask=mask,
        shown=face.seen.astype(np.float64),
        grey=face.grey,
        light=photo.light,
        direction=None if photo.direction is None else np.array(photo.direction),
        causes=causes,
    )
