"""Photographs in, normals, albedo, light and relit views out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import nn

from sfsnet_dr.apply.methods import ask
from sfsnet_dr.apply.outputs import Decomposed, write_decomposed
from sfsnet_dr.apply.picture import Picture, read_picture
from sfsnet_dr.base import provenance
from sfsnet_dr.base.atomic import output_dir
from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.base.color import srgb_to_linear
from sfsnet_dr.data.photograph import Eyes
from sfsnet_dr.data.pseudo_labels import Values
from sfsnet_dr.data.view import WHOLE, View
from sfsnet_dr.fit.trained import load_trained
from sfsnet_dr.metrics.image import mae_8bit
from sfsnet_dr.model.shipped import weights_path
from sfsnet_dr.render.shading_numpy import shading
from sfsnet_dr.sh.coefficients import Shading


def decompose(
    images: Sequence[Path],
    out: Path | str,
    weights: Path | str,
    *,
    eyes: Eyes | None = None,
    mask: Path | None = None,
) -> list[Decomposed]:
    """Decompose photographs and write a folder for each: pictures, a sheet of them and one EXR.

    Everything is read and checked before anything is written; a face's folder is written whole or not at all.

    Args:
        images: at least one, with different names; see ``read_picture`` for what is allowed.
        out: folder that is made if it is missing; the files of NAME.png go to out/NAME.
        weights: file of ``save_weights``, or the name of a shipped network.
        eyes: eye centres in pixels that hold for every image; side files and canonical pictures if None.
        mask: mask picture that holds for every image; an ellipse if None.

    Raises:
        BadInput: naming the file that is wrong, what was found and what is allowed.
    """
    if not images:
        raise BadInput("images: none given, one at least is needed")
    names = [Path(path).stem for path in images]
    for name in names:
        if names.count(name) > 1:
            raise BadInput(f"images: {names.count(name)} are called {name!r}, and would share a folder")
    trained = load_trained(weights)
    read = [read_picture(path, eyes, mask) for path in images]
    folder = output_dir(out)
    faces = take_apart(trained.model, read, view=trained.view, values=trained.values)
    metadata = {"sfsnet_dr:weights_sha256": provenance.sha256(weights_path(weights))}
    for face in faces:
        write_decomposed(folder, face, metadata)
    return faces


def take_apart(
    model: nn.Module, read: Sequence[Picture], *, view: View = WHOLE, values: Values = "linear"
) -> list[Decomposed]:
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
        Decomposed(
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


def reconstruction_error(face: Decomposed) -> float:
    """Mean absolute difference of reconstruction and input on the face, 8-bit sRGB units.

    It says how well the three parts explain the picture, not whether they are right: a wrong albedo with the
    inverse wrong shading reconstructs perfectly.
    """
    return mae_8bit(face.reconstruction, face.image, face.mask)
