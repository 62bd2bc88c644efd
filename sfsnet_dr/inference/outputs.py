"""What one decomposition leaves on disk: pictures to look at, one EXR to compute with."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.core.color import srgb_to_linear
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import output_dir
from sfsnet_dr.core.image_io import write_exr, write_png
from sfsnet_dr.core.visualize import Pixels, on_white, show_encoded, show_linear, show_normals
from sfsnet_dr.data.pseudo_labels import Encoding
from sfsnet_dr.inference.relight import VIEW_LIGHTS, relight, relit_views
from sfsnet_dr.inference.sheet import draw_sheet
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.sh.coefficients import Shading

if TYPE_CHECKING:
    from torch import Tensor

Array = NDArray[np.floating]

_EXR: Final = "decomposition.exr"
_SHEET: Final = "sheet.png"


@dataclass(frozen=True, eq=False)
class Decomposition:
    """One face taken apart, in the canonical frame, linear light.

    Attributes:
        name: what it is called in labels and folder names.
        image: the input (H, W, 3).
        mask: (H, W) in [0, 1].
        normal: unit vectors (H, W, 3), camera frame.
        albedo: (H, W, 3) as the network gave it, not clamped.
        light: shading coefficients.
        shading: Y(n)^T L (H, W, 3), not clamped.
        reconstruction: albedo times shading (H, W, 3), not clamped; decoded where that is encoded.
        encoding: "srgb" if the network was trained in the paper's display-referred form: albedo times
            shading is then the sRGB-encoded image, and both are shown as they are.
    """

    name: str
    image: Array
    mask: Array
    normal: Array
    albedo: Array
    light: Shading
    shading: Array
    reconstruction: Array
    encoding: Encoding = "linear"

    def relight(self, light: Light | Shading) -> NDArray[np.float64]:
        """Return the face under another light, by order-2 shading: no shadows, no interreflection.

        Args:
            light: a light, or its shading coefficients of order 0 to 8.

        Returns:
            Linear image (H, W, 3), not negative where the albedo is not. Of a network that was trained on
            encoded images the product is encoded, and is decoded here.

        Example:
            >>> import numpy as np
            >>> import sfsnet_dr as sf
            >>> face = sf.decompose(np.full((128, 128, 3), 0.3))
            >>> face.relight(sf.Light.from_direction((-1, 0.2, 0.7))).shape
            (128, 128, 3)
        """
        shading = light.shading_label() if isinstance(light, Light) else light
        image = relight(self.normal, self.albedo, shading)
        return image if self.encoding == "linear" else np.asarray(srgb_to_linear(image), np.float64)

    def to_torch(self) -> dict[str, Tensor]:
        """Return the maps as float32 tensors: images (1, 3, H, W), mask (1, 1, H, W), light (1, 27)."""
        import torch

        names = ("normal", "albedo", "shading", "reconstruction", "image")
        planes = {name: np.moveaxis(getattr(self, name), -1, 0)[None] for name in names}
        planes |= {"mask": self.mask[None, None], "light": self.light.flat()[None]}
        return {name: torch.from_numpy(np.array(values, np.float32)) for name, values in planes.items()}

    def save(self, folder: Path | str) -> Path:
        """Write pictures, a sheet of them and ``decomposition.exr`` into ``folder / name``; see ``docs``.

        Raises:
            InputError: if that folder holds files that a decomposition does not write.
        """
        return write_decomposition(output_dir(folder), self, {})

    def _repr_png_(self) -> bytes:
        """Input, maps and relit views with labels, for notebooks."""
        return draw_sheet(list(decomposition_pictures(self).values()), title=self.name)


def decomposition_pictures(face: Decomposition) -> dict[str, tuple[str, Pixels]]:
    """File stem -> (label, 8-bit picture), in reading order; white outside the mask, but for the input.

    Shading is divided by its largest value on the face if that is above 1, so that it does not burn out.
    """
    show = show_linear if face.encoding == "linear" else show_encoded
    peak = max(1.0, float((face.shading * face.mask[..., None]).max()))
    maps = {
        "normal": ("Normals", show_normals(face.normal)),
        "albedo": ("Albedo", show(face.albedo)),
        "shading": ("Shading", show(face.shading / peak)),
        "reconstruction": ("Reconstruction", show_linear(face.reconstruction)),
    }
    for side, view in relit_views(face.normal, face.albedo).items():
        maps[f"relit_{side}"] = (f"Lit from the {side}", show(view))
    masked = {stem: (label, on_white(picture, face.mask)) for stem, (label, picture) in maps.items()}
    return {"input": ("Input", show_linear(face.image))} | masked


def write_decomposition(folder: Path | str, face: Decomposition, metadata: Mapping[str, str]) -> Path:
    """Write all files of one face into ``folder / face.name``, the whole folder or nothing.

    Args:
        folder: exists and is writable.
        face: what to write.
        metadata: strings for the EXR; the 27 light coefficients are added as ``sfsnet_dr:light``.

    Returns:
        The folder of this face.

    Raises:
        InputError: if that folder exists and holds files that a decomposition does not write.
    """
    target = Path(folder) / face.name
    with _whole_folder(target) as partial:
        shown = decomposition_pictures(face)
        for stem, (_, picture) in shown.items():
            write_png(partial / f"{stem}.png", picture / 255.0, encoded=True)
        (partial / _SHEET).write_bytes(draw_sheet(list(shown.values()), title=face.name))
        light = json.dumps([float(value) for value in face.light.flat()])
        strings = {**metadata, "sfsnet_dr:light": light, "sfsnet_dr:values": face.encoding}
        write_exr(partial / _EXR, _channels(face), strings)
    return target


def _channels(face: Decomposition) -> dict[str, Array]:
    channels: dict[str, Array] = {"mask.Y": face.mask}
    for name, letters in {"image": "RGB", "normal": "XYZ", "albedo": "RGB", "shading": "RGB"}.items():
        for index, letter in enumerate(letters):
            channels[f"{name}.{letter}"] = getattr(face, name)[..., index]
    for index, letter in enumerate("RGB"):
        channels[f"reconstruction.{letter}"] = face.reconstruction[..., index]
    return channels


def _file_names() -> set[str]:
    stems = ["input", "normal", "albedo", "shading", "reconstruction", *(f"relit_{s}" for s in VIEW_LIGHTS)]
    return {f"{stem}.png" for stem in stems} | {_EXR, _SHEET}


@contextmanager
def _whole_folder(target: Path) -> Iterator[Path]:
    """Give a temporary folder beside ``target`` that takes its place if the block ends well."""
    if target.exists():
        strange = (
            sorted(p.name for p in target.iterdir() if p.name not in _file_names())
            if target.is_dir()
            else ["a file"]
        )
        if strange:
            raise InputError(
                f"{target}: holds {strange[0]!r}, which no decomposition wrote; choose another --out"
            )
    partial = Path(tempfile.mkdtemp(prefix=".partial-", dir=target.parent))
    try:
        yield partial
        partial.chmod(target.parent.stat().st_mode & 0o777)
        old = partial.with_name(partial.name + "-old")
        if target.exists():
            os.rename(target, old)
        os.rename(partial, target)
        shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
