"""Photographs in; normals, albedo, light and relit views out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import torch
from numpy.typing import NDArray

from sfsnet_dr.core import provenance
from sfsnet_dr.core.color import srgb_to_linear
from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.core.files import output_dir
from sfsnet_dr.data.alignment import Eyes
from sfsnet_dr.data.pseudo_labels import Encoding
from sfsnet_dr.data.transforms.crop import WHOLE, Crop
from sfsnet_dr.inference.methods import infer
from sfsnet_dr.inference.outputs import Decomposition, write_decomposition
from sfsnet_dr.inference.photograph import Photograph, align_photograph, read_photograph
from sfsnet_dr.metrics.image import mae_8bit
from sfsnet_dr.models.inference import LoadedModel, load_model
from sfsnet_dr.models.shipped import BEST, weights_path
from sfsnet_dr.render.shading_numpy import shading
from sfsnet_dr.sh.coefficients import Shading

if TYPE_CHECKING:
    from torch import Tensor, nn


@overload
def decompose(
    image: Path | str,
    model: LoadedModel | Path | str = BEST,
    *,
    eyes: Eyes | None = None,
    mask: NDArray[Any] | Path | str | None = None,
    encoding: Encoding | None = None,
) -> Decomposition: ...


@overload
def decompose(
    image: NDArray[Any] | Tensor,
    model: LoadedModel | Path | str = BEST,
    *,
    eyes: Eyes | None = None,
    mask: NDArray[Any] | Path | str | None = None,
    encoding: Encoding | None = None,
) -> Decomposition | list[Decomposition]: ...


def decompose(
    image: NDArray[Any] | Tensor | Path | str,
    model: LoadedModel | Path | str = BEST,
    *,
    eyes: Eyes | None = None,
    mask: NDArray[Any] | Path | str | None = None,
    encoding: Encoding | None = None,
) -> Decomposition | list[Decomposition]:
    """Split a photograph of a face into normals, albedo and light.

    The network answers for the image and for its mirror image, and the mean is returned; the image is metered
    first, so that dark and bright photographs of one face give the same normals.

    Args:
        image: a file; or an array (H, W, 3) or (B, H, W, 3); or a tensor (3, H, W) or (B, 3, H, W). Without
            ``eyes`` it must be 128 x 128 pixels in the canonical face frame (eye centres at (45, 48) and
            (83, 48), x right, y down).
        model: of ``load_model``, or the name or file of weights.
        eyes: eye centres ((xl, yl), (xr, yr)) in pixels, the one on the image's left first; they hold for the
            whole batch. A file may have them beside it (NAME.toml).
        mask: (H, W), more than 0.5 on the face, or a file; an ellipse if left out.
        encoding: ``"srgb"`` or ``"linear"``; left out, unsigned integers are sRGB and floats linear light.
            Files say it themselves.

    Returns:
        A ``Decomposition``; for a batch a list of them.

    Raises:
        InputError: naming what is wrong, what was found and what is allowed.

    Source: Sengupta et al., SfSNet, CVPR 2018.

    Example:
        >>> import numpy as np
        >>> import sfsnet_dr as sf
        >>> grey = np.full((128, 128, 3), 0.3)
        >>> face = sf.decompose(grey, sf.load_model("skipnet"))
        >>> face.normal.shape, face.albedo.shape, face.light.flat().shape
        ((128, 128, 3), (128, 128, 3), (27,))
        >>> batch = sf.decompose(np.stack([grey, grey]), "skipnet")
        >>> len(batch)
        2
    """
    loaded = model if isinstance(model, LoadedModel) else load_model(model)
    if isinstance(image, Path | str):
        if encoding is not None:
            raise InputError(f"encoding: {encoding!r} found, files say it themselves; leave it out")
        if mask is not None and not isinstance(mask, Path | str):
            raise InputError("mask: an array found, a file is needed beside a file")
        return decompose_photographs(loaded, [read_photograph(image, eyes, mask)])[0]
    if isinstance(mask, Path | str):
        raise InputError("mask: a file found, an array (H, W) is needed beside an array")
    images, single = _as_linear_batch(image, encoding)
    weights = None if mask is None else np.asarray(mask, np.float32)
    faces = decompose_photographs(
        loaded, [align_photograph(f"image{k}", each, eyes, weights) for k, each in enumerate(images)]
    )
    return faces[0] if single else faces


def _as_linear_batch(image: Any, encoding: Encoding | None) -> tuple[NDArray[np.float32], bool]:
    """Return linear images (B, H, W, 3), and whether one image without a batch was given."""
    if isinstance(image, torch.Tensor):
        planes = image.detach().cpu().numpy()
        single = planes.ndim == 3
        check_shape("image", planes, "3 H W" if single else "B 3 H W")
        array = np.moveaxis(planes, -3, -1)
    else:
        array = np.asarray(image)
        single = array.ndim == 3
        check_shape("image", array, "H W 3" if single else "B H W 3")
    if array.dtype.kind == "u":
        largest = np.iinfo(array.dtype).max
        encoding, array = encoding or "srgb", array / largest
    elif array.dtype.kind != "f":
        raise InputError(f"image: {array.dtype} found, floats or unsigned integers are needed")
    if encoding not in ("linear", "srgb", None):
        raise InputError(f"encoding: {encoding!r} found; allowed: linear, srgb")
    if not np.isfinite(array).all():
        raise InputError("image: NaN or inf found, finite values are needed")
    linear = srgb_to_linear(array) if encoding == "srgb" else array
    return np.asarray(linear[None] if single else linear, np.float32), single


def decompose_files(
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
        images: at least one, with different names; see ``read_photograph`` for what is allowed.
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
    loaded = load_model(weights)
    read = [read_photograph(path, eyes, mask) for path in images]
    folder = output_dir(out)
    faces = decompose_photographs(loaded, read)
    metadata = {"sfsnet_dr:weights_sha256": provenance.sha256(weights_path(weights))}
    for face in faces:
        write_decomposition(folder, face, metadata)
    return faces


def decompose_photographs(loaded: LoadedModel, photographs: Sequence[Photograph]) -> list[Decomposition]:
    """Decompose photographs in the canonical frame; writes nothing."""
    return run_network(loaded.model, photographs, view=loaded.crop, values=loaded.encoding)


def run_network(
    model: nn.Module, photographs: Sequence[Photograph], *, view: Crop = WHOLE, values: Encoding = "linear"
) -> list[Decomposition]:
    """Run any network on photographs in the canonical frame; writes nothing.

    Args:
        model: the network.
        photographs: at least one, all of one size.
        view: the part of the frame that the network was trained on; see ``methods.ask``.
        values: the encoding that the network was trained on. Its albedo and shading explain the image in this
            encoding, and are kept as they are.
    """
    images = torch.from_numpy(np.stack([np.moveaxis(each.image, -1, 0) for each in photographs])).float()
    masks = torch.from_numpy(np.stack([each.mask for each in photographs])).float()[:, None]
    found, gain = infer(model, images, masks, view, values)
    normal, albedo, light = (part.double().numpy() for part in found)
    shade = shading(normal, light)
    image = albedo * shade if values == "linear" else srgb_to_linear(albedo * shade) / gain.double().numpy()
    maps = [np.moveaxis(part, 1, -1) for part in (normal, albedo, shade, image)]
    return [
        Decomposition(
            name=each.name,
            image=each.image,
            mask=np.asarray(each.mask, np.float32),
            normal=maps[0][index],
            albedo=maps[1][index],
            light=Shading.from_flat(light[index]),
            shading=maps[2][index],
            reconstruction=maps[3][index],
            encoding=values,
        )
        for index, each in enumerate(photographs)
    ]


def reconstruction_error(face: Decomposition) -> float:
    """Return the mean absolute difference of reconstruction and input on the face, 8-bit sRGB units.

    It says how well the three parts explain the picture, not whether they are right: a wrong albedo with the
    inverse wrong shading reconstructs perfectly.
    """
    return mae_8bit(face.reconstruction, face.image, face.mask)
