"""Photographs in, normals, albedo, light and relit views out.

A photograph as the network wants it: in the canonical face frame, with a mask.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from sfsnet_dr.core import provenance
from sfsnet_dr.core.color import srgb_to_linear
from sfsnet_dr.core.conventions import FACE_SIZE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import output_dir
from sfsnet_dr.core.image_io import read_image
from sfsnet_dr.data.alignment import Eyes, face_ellipse_mask, inside, read_eyes, side_file, to_canonical
from sfsnet_dr.data.pseudo_labels import Values
from sfsnet_dr.data.transforms.crop import WHOLE, View
from sfsnet_dr.inference.methods import ask
from sfsnet_dr.inference.outputs import Decomposition, write_decomposition
from sfsnet_dr.metrics.image import mae_8bit
from sfsnet_dr.models.inference import load_model
from sfsnet_dr.models.shipped import weights_path
from sfsnet_dr.render.shading_numpy import shading
from sfsnet_dr.sh.coefficients import Shading


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
        InputError: naming the file, what was found and what is allowed.
    """
    path = Path(path)
    image = read_image(path, channels=3).pixels
    if eyes is None and side_file(path).is_file():
        eyes = read_eyes(side_file(path))
    height, width = image.shape[:2]
    if eyes is None and (height, width) != (FACE_SIZE, FACE_SIZE):
        raise InputError(
            f"{path}: {width} x {height} pixels found without eye centres; {FACE_SIZE} x {FACE_SIZE} in the "
            f"canonical frame is allowed, or any size with --eyes or {side_file(path).name} beside it"
        )
    face = face_ellipse_mask() if mask is None else _read_mask(Path(mask), path, (height, width), eyes)
    if eyes is not None:
        image, covered = _aligned(path, image, eyes)
        face = face * covered
    if not face.any():
        raise InputError(
            f"{mask or path}: the mask is empty in the face frame, one face pixel at least is needed"
        )
    return Picture(path.stem, image, face)


def eyes_from_text(name: str, text: str) -> Eyes:
    """Eye centres from "xl,yl,xr,yr"; ``name`` is where the text was given, for the message."""
    try:
        xl, yl, xr, yr = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"{name}: {text!r} found, four numbers XL,YL,XR,YR in pixels are needed") from error
    return (xl, yl), (xr, yr)


def _aligned(
    path: Path, image: NDArray[np.float32], eyes: Eyes
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The picture in the canonical frame, and the share of each pixel that it covers."""
    try:
        return to_canonical(image, eyes), inside(image.shape[0], image.shape[1], eyes)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _read_mask(path: Path, of: Path, size: tuple[int, int], eyes: Eyes | None) -> NDArray[np.float32]:
    found = read_image(path, channels=3).pixels
    if found.shape[:2] != size:
        raise InputError(
            f"{path}: mask of {found.shape[1]} x {found.shape[0]} pixels found, "
            f"{size[1]} x {size[0]} as {of.name} has is needed"
        )
    light = (found > 0.5).astype(np.float32)
    return (light if eyes is None else _aligned(of, light, eyes)[0])[..., 0]


def decompose(
    images: Sequence[Path],
    out: Path | str,
    weights: Path | str,
    *,
    eyes: Eyes | None = None,
    mask: Path | None = None,
) -> list[Decomposition]:
    """Decompose photographs and write a folder for each: pictures, a sheet of them and one EXR.

    Everything is read and checked before anything is written; a face's folder is written whole or not at all.

    Args:
        images: at least one, with different names; see ``read_picture`` for what is allowed.
        out: folder that is made if it is missing; the files of NAME.png go to out/NAME.
        weights: file of ``save_weights``, or the name of a shipped network.
        eyes: eye centres in pixels that hold for every image; side files and canonical pictures if None.
        mask: mask picture that holds for every image; an ellipse if None.

    Raises:
        InputError: naming the file that is wrong, what was found and what is allowed.
    """
    if not images:
        raise InputError("images: none given, one at least is needed")
    names = [Path(path).stem for path in images]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"images: {names.count(name)} are called {name!r}, and would share a folder")
    trained = load_model(weights)
    read = [read_picture(path, eyes, mask) for path in images]
    folder = output_dir(out)
    faces = take_apart(trained.model, read, view=trained.view, values=trained.values)
    metadata = {"sfsnet_dr:weights_sha256": provenance.sha256(weights_path(weights))}
    for face in faces:
        write_decomposition(folder, face, metadata)
    return faces


def take_apart(
    model: nn.Module, read: Sequence[Picture], *, view: View = WHOLE, values: Values = "linear"
) -> list[Decomposition]:
    """Run the network on pictures of the canonical frame; writes nothing.

    Args:
        model: the network.
        read: at least one picture, all of one size.
        view: what it was shown of the frame in training; see ``methods.ask``.
        values: what a photograph's numbers are to the network. Its albedo and shading explain those, and are
            kept as they are.
    """
    images = torch.from_numpy(np.stack([np.moveaxis(picture.image, -1, 0) for picture in read])).float()
    masks = torch.from_numpy(np.stack([picture.mask for picture in read])).float()[:, None]
    found, gain = ask(model, images, masks, view, values)
    normal, albedo, light = (part.double().numpy() for part in found)
    shade = shading(normal, light)
    image = albedo * shade if values == "linear" else srgb_to_linear(albedo * shade) / gain.double().numpy()
    maps = [np.moveaxis(part, 1, -1) for part in (normal, albedo, shade, image)]
    return [
        Decomposition(
            name=picture.name,
            image=picture.image,
            mask=np.asarray(picture.mask, np.float32),
            normal=maps[0][index],
            albedo=maps[1][index],
            light=Shading.from_flat(light[index]),
            shading=maps[2][index],
            reconstruction=maps[3][index],
            values=values,
        )
        for index, picture in enumerate(read)
    ]


def reconstruction_error(face: Decomposition) -> float:
    """Mean absolute difference of reconstruction and input on the face, 8-bit sRGB units.

    It says how well the three parts explain the picture, not whether they are right: a wrong albedo with the
    inverse wrong shading reconstructs perfectly.
    """
    return mae_8bit(face.reconstruction, face.image, face.mask)
