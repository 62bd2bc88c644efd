"""A database whose lamps are not known, told where they are by its pictures and a network."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import torch

from sfsnet_dr.apply.methods import NetworkMethod
from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.data.listing import FacePhoto, Listing, read_face
from sfsnet_dr.data.photo_set import Skipped
from sfsnet_dr.fit.self_calibration import Guess, find_lamps
from sfsnet_dr.metrics.light_classes import light_direction
from sfsnet_dr.metrics.normals import angles_deg
from sfsnet_dr.model.shipped import weights_path

Array = npt.NDArray[np.float64]

#: Pixels of a capture that lamps are found from.
_SAMPLED: Final = 1000
_BATCH: Final = 16


def with_found_lamps(
    listing: Listing, weights: Path | str, on_capture: Callable[[], object] = lambda: None
) -> Listing:
    """The photographs with the directions that ``fit.self_calibration`` finds; none is read from the listing.

    Args:
        listing: captures of 12 lamps or more. A lamp's name means the same lamp in every capture.
        weights: of the network that makes the first guess, a file or a shipped name.
        on_capture: called after each.

    Returns:
        ``lamps_by`` names the weights. Photographs under lamps that cannot be found, or that have no name,
        have no direction.

    Raises:
        BadInput: for unusable weights or photographs, or if no capture has as many lamps as are needed.
    """
    method = NetworkMethod(Path(weights_path(weights)).stem, weights)
    guesses: list[Guess] = []
    skipped: list[Skipped] = []
    for photos in listing.captures().values():
        named = [photo for photo in photos if photo.light]
        guess = _guess(method, named, listing.linear, skipped)
        if guess is not None:
            guesses.append(guess)
        on_capture()
    found = find_lamps(guesses)
    lost = [
        Skipped(photo.name, f"lamp {photo.light}: {found.lost[photo.light]}")
        for photo in listing.photos
        if photo.light in found.lost
    ]
    return replace(
        listing,
        photos=tuple(
            replace(photo, direction=_direction(found.direction, photo.light)) for photo in listing.photos
        ),
        skipped=(*listing.skipped, *skipped, *lost),
        lamps_by=method.name,
    )


def _guess(
    method: NetworkMethod, photos: Sequence[FacePhoto], linear: bool, skipped: list[Skipped]
) -> Guess | None:
    """What a network says of one capture; None where no picture of it can be read."""
    faces = []
    for photo in photos:
        try:
            faces.append((photo.light, read_face(photo, linear)))
        except BadInput as error:
            skipped.append(Skipped(photo.name, str(error)))
    if not faces:
        return None
    images = torch.stack([torch.from_numpy(np.moveaxis(face.image, -1, 0)).float() for _, face in faces])
    mask = torch.from_numpy(np.min([face.mask for _, face in faces], axis=0)).float()
    normal, light = torch.zeros_like(images[0]), []
    for part in torch.split(images, _BATCH):
        answer = method(part, mask.expand(len(part), 1, -1, -1), [""] * len(part))
        normal += answer.normal.sum(0)
        light.append(answer.light.double())
    pixels = torch.nonzero(mask.flatten() > 0.5)[:, 0]
    pixels = pixels[:: max(1, len(pixels) // _SAMPLED)]
    mean = normal.flatten(1)[:, pixels].T.double().numpy()
    return Guess(
        values=images.mean(1).flatten(1)[:, pixels].T.double().numpy(),
        lamps=tuple(lamp for lamp, _ in faces),
        normal=mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-9),
        direction=light_direction(torch.cat(light).numpy()),
    )


def _direction(found: Mapping[str, Array], lamp: str) -> tuple[float, float, float] | None:
    if lamp not in found:
        return None
    x, y, z = (float(value) for value in found[lamp])
    return x, y, z


def lamp_errors(known: Listing, found: Listing) -> dict[str, float]:
    """Angle between the direction that a database tells and the one that was found, degrees, by lamp."""
    told = {photo.light: photo.direction for photo in known.photos if photo.direction is not None}
    return {
        photo.light: float(angles_deg(np.array(photo.direction), np.array(told[photo.light])))
        for photo in found.photos
        if photo.direction is not None and photo.light in told
    }
