"""A photograph as the network wants it: in the canonical face frame, linear, with a mask."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.core.conventions import FACE_SIZE
from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.core.image_io import read_image
from sfsnet_dr.data.alignment import (
    Eyes,
    canonical_coverage,
    face_ellipse_mask,
    read_eyes,
    side_file,
    to_canonical,
)

Array = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Photograph:
    """One photograph in the canonical frame.

    Attributes:
        name: the file's name without its ending.
        image: linear (128, 128, 3) float32.
        mask: (128, 128) in [0, 1], 1 on the face.
    """

    name: str
    image: Array
    mask: Array


def read_photograph(path: Path | str, eyes: Eyes | None = None, mask: Path | str | None = None) -> Photograph:
    """Read a photograph and bring it to the canonical frame.

    Eye centres come from ``eyes``, else from the side file beside the picture (same name, ``.toml``). Without
    either the picture must have the canonical size and counts as aligned.

    Args:
        path: the picture, any format of ``read_image``; grey becomes equal red, green and blue.
        eyes: centres in pixels of the picture.
        mask: a picture of the same size, light on the face and dark elsewhere; an ellipse if not given.

    Raises:
        InputError: naming the file, what was found and what is allowed.
    """
    path = Path(path)
    image = read_image(path, channels=3).pixels
    if eyes is None and side_file(path).is_file():
        eyes = read_eyes(side_file(path))
    given = None if mask is None else _read_mask(Path(mask), path, (image.shape[0], image.shape[1]))
    advice = f" with --eyes or {side_file(path).name} beside it"
    return align_photograph(path.stem, image, eyes, given, where=str(path), mask_name=mask, advice=advice)


def align_photograph(
    name: str,
    image: Array,
    eyes: Eyes | None = None,
    mask: Array | None = None,
    *,
    where: str = "image",
    mask_name: Path | str | None = None,
    advice: str = " with eyes=((xl, yl), (xr, yr))",
) -> Photograph:
    """Bring an image to the canonical frame.

    Args:
        name: what it is called in labels and folder names.
        image: linear (H, W, 3).
        eyes: centres in pixels, the one on the image's left first; None for an image that is aligned.
        mask: (H, W) in [0, 1], more than 0.5 on the face; an ellipse if not given.
        where: what the image is called in messages.
        mask_name: what the mask is called in messages.
        advice: how to give eye centres, for the message.

    Raises:
        InputError: for another shape, an image without eyes that has not the canonical size, unusable eyes,
            or a mask without a pixel of the face frame.
    """
    height, width = (check_shape(where, image, "H W 3")[axis] for axis in ("H", "W"))
    if eyes is None and (height, width) != (FACE_SIZE, FACE_SIZE):
        raise InputError(
            f"{where}: {width} x {height} pixels found without eye centres; {FACE_SIZE} x {FACE_SIZE} in the "
            f"canonical frame is allowed, or any size{advice}"
        )
    if mask is None:
        face = face_ellipse_mask()
    else:
        check_shape(f"{mask_name or 'mask'}", mask, "H W", H=height, W=width)
        light = (mask > 0.5).astype(np.float32)
        face = light if eyes is None else _aligned(where, light[..., None].repeat(3, 2), eyes)[0][..., 0]
    if eyes is not None:
        image, covered = _aligned(where, image, eyes)
        face = face * covered
    if not face.any():
        raise InputError(
            f"{mask_name or where}: the mask is empty in the face frame, one face pixel at least is needed"
        )
    return Photograph(name, np.asarray(image, np.float32), face)


def parse_eyes(name: str, text: str) -> Eyes:
    """Return eye centres from "xl,yl,xr,yr"; ``name`` is where the text was given, for the message.

    Raises:
        InputError: for anything but four numbers.
    """
    try:
        xl, yl, xr, yr = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"{name}: {text!r} found, four numbers XL,YL,XR,YR in pixels are needed") from error
    return (xl, yl), (xr, yr)


def _aligned(where: str, image: Array, eyes: Eyes) -> tuple[Array, Array]:
    """Return the image in the canonical frame, and the share of each pixel that it covers."""
    try:
        return to_canonical(image, eyes), canonical_coverage(image.shape[0], image.shape[1], eyes)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _read_mask(path: Path, of: Path, size: tuple[int, int]) -> Array:
    found = read_image(path, channels=3).pixels
    if found.shape[:2] != size:
        raise InputError(
            f"{path}: mask of {found.shape[1]} x {found.shape[0]} pixels found, "
            f"{size[1]} x {size[0]} as {of.name} has is needed"
        )
    return found[..., 0]
