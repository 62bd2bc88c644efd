"""A photograph as the network wants it: in the canonical face frame, with a mask."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.base.conventions import FACE_SIZE
from sfsnet_dr.base.imageio import read_image
from sfsnet_dr.data.photograph import Eyes, face_ellipse_mask, inside, read_eyes, side_file, to_canonical


@dataclass(frozen=True, eq=False)
class Picture:
    """One photograph in the canonical frame.

    Attributes:
        name: the file's name without its ending.
        image: linear (128, 128, 3) float32.
        mask: (128, 128) in [0, 1], 1 on the face.
    """

    name: str
    image: NDArray[np.float32]
    mask: NDArray[np.float32]


def read_picture(path: Path | str, eyes: Eyes | None = None, mask: Path | str | None = None) -> Picture:
    """Read a photograph and bring it to the canonical frame.

    Eye centres come from ``eyes``, else from the side file beside the picture (same name, ``.toml``). Without
    either the picture must have the canonical size and counts as aligned.

    Args:
        path: the picture, any format of ``read_image``; grey becomes equal red, green and blue.
        eyes: centres in pixels of the picture.
        mask: a picture of the same size, light on the face and dark elsewhere; an ellipse if not given.

    Raises:
        BadInput: naming the file, what was found and what is allowed.
    """
    path = Path(path)
    image = read_image(path, channels=3).pixels
    if eyes is None and side_file(path).is_file():
        eyes = read_eyes(side_file(path))
    height, width = image.shape[:2]
    if eyes is None and (height, width) != (FACE_SIZE, FACE_SIZE):
        raise BadInput(
            f"{path}: {width} x {height} pixels found without eye centres; {FACE_SIZE} x {FACE_SIZE} in the "
            f"canonical frame is allowed, or any size with --eyes or {side_file(path).name} beside it"
        )
    face = face_ellipse_mask() if mask is None else _read_mask(Path(mask), path, (height, width), eyes)
    if eyes is not None:
        image, covered = _aligned(path, image, eyes)
        face = face * covered
    if not face.any():
        raise BadInput(
            f"{mask or path}: the mask is empty in the face frame, one face pixel at least is needed"
        )
    return Picture(path.stem, image, face)


def eyes_from_text(name: str, text: str) -> Eyes:
    """Eye centres from "xl,yl,xr,yr"; ``name`` is where the text was given, for the message."""
    try:
        xl, yl, xr, yr = (float(part) for part in text.split(","))
    except ValueError as error:
        raise BadInput(f"{name}: {text!r} found, four numbers XL,YL,XR,YR in pixels are needed") from error
    return (xl, yl), (xr, yr)


def _aligned(
    path: Path, image: NDArray[np.float32], eyes: Eyes
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The picture in the canonical frame, and the share of each pixel that it covers."""
    try:
        return to_canonical(image, eyes), inside(image.shape[0], image.shape[1], eyes)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error


def _read_mask(path: Path, of: Path, size: tuple[int, int], eyes: Eyes | None) -> NDArray[np.float32]:
    found = read_image(path, channels=3).pixels
    if found.shape[:2] != size:
        raise BadInput(
            f"{path}: mask of {found.shape[1]} x {found.shape[0]} pixels found, "
            f"{size[1]} x {size[0]} as {of.name} has is needed"
        )
    light = (found > 0.5).astype(np.float32)
    return (light if eyes is None else _aligned(of, light, eyes)[0])[..., 0]
