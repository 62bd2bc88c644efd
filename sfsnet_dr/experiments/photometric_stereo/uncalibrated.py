"""A database whose lamps are not known, told where they are by its pictures and a network."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import torch

from sfsnet_dr.data.databases.base import FacePhoto, Listing
from sfsnet_dr.data.dataset import Folders
from sfsnet_dr.data.normal_labels import head_normals, mean_normals
from sfsnet_dr.estimation.bas_relief import resolve_bas_relief_scale, vertical_scale_from_integrability
from sfsnet_dr.estimation.light_calibration import CalibratedLights, InitialNormals, calibrate_lights
from sfsnet_dr.estimation.photometric_stereo import FEWEST, fit_pixels, is_valid
from sfsnet_dr.experiments.photometric_stereo.captures import ImageSet, ImageSets
from sfsnet_dr.inference.methods import NetworkMethod
from sfsnet_dr.metrics.light import light_direction
from sfsnet_dr.metrics.normals import angles_deg
from sfsnet_dr.models.shipped import weights_name

Array = npt.NDArray[np.float64]

#: Pixels of a capture that lamps are found from.
_SAMPLED: Final = 1000
_BATCH: Final = 16
#: Heads that tell how steep faces are.
_HEADS: Final = 300
#: How often the stretch down a face is looked for: where lamps are found anew, other pixels are in shadow.
_ROUNDS: Final = 3


def calibrate_image_sets(
    read: ImageSets,
    weights: Path | str,
    heads: Folders = (),
    on_capture: Callable[[], object] = lambda: None,
) -> ImageSets:
    """The photographs with the directions that ``fit.self_calibration`` finds; none is read from the listing.

    Args:
        read: captures of 12 lamps or more. A lamp's name means the same lamp in every capture.
        weights: of the network that makes the first guess, a file or a shipped name.
        heads: folders of rendered heads, which tell how people face on average and how steep their slopes
            are; none to leave that to the network.
        on_capture: called after each.

    Returns:
        ``listing.calibrated_by`` names the weights. Photographs under lamps that cannot be found, or that
        have no name, have no direction.

    Raises:
        InputError: for unusable weights or heads, or if no capture has as many lamps as are needed.
    """
    method = NetworkMethod(weights_name(weights), weights)
    usual = mean_normals(heads) if heads else None
    guesses = []
    for face in read.faces:
        named = face.only([bool(lamp) for lamp in face.lamps])
        if named.photos:
            guesses.append(_guess(method, named, usual))
        on_capture()
    found = calibrate_lights(guesses)
    known = list(head_normals(heads, _HEADS)) if heads else []
    usual_stretch = (
        vertical_scale_from_integrability(known) if known else 1.0
    )  # what noise, folds and edges make of it
    for _ in range(_ROUNDS):
        down = vertical_scale_from_integrability([_normals(face, found) for face in read.faces])
        found = found.for_stretched(1.0, down / usual_stretch)
    if known:
        deeper = resolve_bas_relief_scale([_normals(face, found) for face in read.faces], known)
        found = found.for_stretched(deeper, deeper)

    def placed(photo: FacePhoto) -> FacePhoto:
        return replace(photo, direction=_direction(found.direction, photo.light))

    photos = tuple(placed(photo) for photo in read.listing.photos)
    faces = tuple(replace(face, photos=tuple(map(placed, face.photos))) for face in read.faces)
    lost = {
        photo.name: f"lamp {photo.light}: {found.lost[photo.light]}"
        for photo in photos
        if photo.light in found.lost
    }
    listing = replace(read.listing, photos=photos, calibrated_by=method.name)
    return ImageSets(listing, faces, read.skipped | lost)


def _guess(method: NetworkMethod, capture: ImageSet, usual: torch.Tensor | None) -> InitialNormals:
    """What a network says of one capture."""
    images = torch.from_numpy(np.moveaxis(capture.images, -1, 1)).float().expand(-1, 3, -1, -1)
    mask = torch.from_numpy(capture.mask).float()
    normal, light = torch.zeros_like(images[0]), []
    for part in torch.split(images, _BATCH):
        answer = method(part, mask.expand(len(part), 1, -1, -1), [""] * len(part))
        normal += answer.normal.sum(0)
        light.append(answer.light.double())
    pixels = torch.nonzero(mask.flatten() > 0.5)[:, 0]
    pixels = pixels[:: max(1, len(pixels) // _SAMPLED)]
    mean = normal.flatten(1)[:, pixels].T.double().numpy()
    return InitialNormals(
        values=images.mean(1).flatten(1)[:, pixels].T.double().numpy(),
        lamps=capture.lamps,
        normal=mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-9),
        direction=light_direction(torch.cat(light).numpy()),
        usual=None if usual is None else usual.flatten(1)[:, pixels].T.double().numpy(),
    )


def _normals(capture: ImageSet, lamps: CalibratedLights) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Normals times albedo of a whole capture by lamps that were found, and where they are known."""
    used = capture.only([lamp in lamps.direction for lamp in capture.lamps])
    skin = used.mask > 0.5
    values = used.images.mean(-1)[:, skin].T
    strength = np.array([lamps.strength[lamp] for lamp in used.lamps])
    directions = np.array([lamps.direction[lamp] for lamp in used.lamps])
    normals = np.zeros((*skin.shape, 3))
    known = len(used.photos) >= FEWEST
    if known:
        normals[skin], _ = fit_pixels(values / strength, is_valid(values), directions)
    return normals, skin & known


def _direction(found: Mapping[str, Array], lamp: str) -> tuple[float, float, float] | None:
    if lamp not in found:
        return None
    x, y, z = (float(value) for value in found[lamp])
    return x, y, z


def light_direction_errors(known: Listing, found: Listing) -> dict[str, float]:
    """Angle between the direction that a database tells and the one that was found, degrees, by lamp."""
    told = {photo.light: photo.direction for photo in known.photos if photo.direction is not None}
    return {
        photo.light: float(angles_deg(np.array(photo.direction), np.array(told[photo.light])))
        for photo in found.photos
        if photo.direction is not None and photo.light in told
    }
