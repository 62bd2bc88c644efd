"""Labels by photometric stereo: a folder of faces with normals, albedo and known lights.

A folder holds ``normal_labels.json`` and one ``CAPTURE.safetensors`` a capture. ``normal_labels.json`` has
``format``, ``database``, ``oblique`` and ``strength`` (the gains of ``fit.strobes``), ``calibrated_by`` (the
network that helped to find where the lamps were; empty where the database tells it), ``captures`` (name ->
subject and SHA-256 of its file) and ``skipped`` (name -> reason). A capture's tensors, S = 128 pixels wide in
the canonical frame, C = 1 for grey pictures and else 3:

``image`` (N, C, S, S) float16, linear, one a light. ``normal`` (3, S, S), ``albedo`` (C, S, S), ``mask``,
``confidence`` and ``residual`` (1, S, S) float16, see ``fit.photometric_stereo``. ``direction`` (N, 3)
float32 toward the lights; ``gain`` (N,) float32, their strengths. The header's ``lights`` and ``files`` name
the N pictures. So ``image = albedo * gain * max(normal . direction, 0)`` where nothing shadows or shines, and
the light's order-2 shading coefficients are those of ``light_labels``.

How rendered heads face on average, and how steep they are: what tells both where no lamp is known.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from sfsnet_dr.core.conventions import FACE_SIZE, LIGHT_ORDER, LIGHT_SIZE
from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.core.files import atomic_path, write_text
from sfsnet_dr.core.provenance import sha256
from sfsnet_dr.data.bundle import read_bundle
from sfsnet_dr.data.dataset import Folders, list_bundles
from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.data.transforms.mirror import mirror_normal
from sfsnet_dr.sh.projection import project_directional

FORMAT: Final = "sfsnet_dr.surfaces.1"
INDEX: Final = "normal_labels.json"


@dataclass(frozen=True, eq=False)
class NormalLabels:
    """One capture; shapes and meaning as in this file's head, float32.

    Attributes:
        name: of the capture; ``subject``: whom it shows.
        lights, files: names of the N pictures.
    """

    name: str
    subject: str
    lights: tuple[str, ...]
    files: tuple[str, ...]
    image: Tensor
    normal: Tensor
    albedo: Tensor
    mask: Tensor
    confidence: Tensor
    residual: Tensor
    direction: Tensor
    gain: Tensor

    @property
    def images(self) -> Tensor:
        """The pictures with three channels, (N, 3, S, S)."""
        return self.image.expand(-1, 3, -1, -1)


_TENSORS: Final = ("image", "normal", "albedo", "mask", "confidence", "residual", "direction", "gain")


def light_labels(direction: npt.ArrayLike, gain: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Shading coefficients (N, 27) of single lights that shade a surface facing them with their ``gain``.

    Args:
        direction: (N, 3).
        gain: (N,).
    """
    vectors, strengths = np.asarray(direction, np.float64), np.asarray(gain, np.float64)
    labels = [
        project_directional(vector, np.full(3, np.pi * strength), LIGHT_ORDER).to_shading().flat()
        for vector, strength in zip(vectors, strengths, strict=True)
    ]
    return np.array(labels).reshape(-1, LIGHT_SIZE)


def write_normal_labels(folder: Path, labels: NormalLabels) -> str:
    """Write one capture, whole or not at all, and give its SHA-256."""
    path = folder / f"{labels.name.replace('/', '__')}.safetensors"
    header = {"name": labels.name, "subject": labels.subject, "lights": labels.lights, "files": labels.files}
    single = ("direction", "gain")
    tensors = {
        name: getattr(labels, name).to(torch.float32 if name in single else torch.float16).contiguous()
        for name in _TENSORS
    }
    with atomic_path(path) as partial:
        save_file(tensors, partial, {"sfsnet_dr": json.dumps(header, sort_keys=True)})
    return sha256(path)


def write_index(
    folder: Path,
    database: str,
    lamps: Mapping[str, Any],
    captures: Mapping[str, Mapping[str, str]],
    skipped: Mapping[str, str],
) -> None:
    """Write ``normal_labels.json``, which makes the folder readable; see this file's head."""
    index = {"format": FORMAT, "database": database, **lamps, "captures": captures, "skipped": skipped}
    write_text(folder / INDEX, json.dumps(index, indent=1, sort_keys=True) + "\n")


def read_index(folder: Path | str) -> dict[str, Any]:
    """What ``normal_labels.json`` says.

    Raises:
        InputError: if it is missing, damaged or of another format.
    """
    path = Path(folder) / INDEX
    if not path.is_file():
        raise InputError(f"{folder}: no {INDEX}; `sfsnet-dr photometric-stereo` writes such a folder")
    try:
        index: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"{path}: cannot be read ({error}); make the labels again") from error
    if index.get("format") != FORMAT:
        raise InputError(f"{path}: format {index.get('format')!r} found, {FORMAT} expected")
    return index


def load_normal_labels(folder: Path | str) -> list[NormalLabels]:
    """All captures of a finished folder, in the order of their names, hashes checked.

    Raises:
        InputError: if the folder or a file of it is missing, changed or damaged.
    """
    folder = Path(folder)
    index = read_index(folder)
    return [_read(folder, name, row["sha256"]) for name, row in sorted(index["captures"].items())]


def _read(folder: Path, name: str, digest: str) -> NormalLabels:
    path = folder / f"{name.replace('/', '__')}.safetensors"
    if not path.is_file() or sha256(path) != digest:
        raise InputError(f"{path}: missing or changed since it was written; make the labels again")
    try:
        tensors = {key: tensor.float() for key, tensor in load_file(path).items()}
        with safe_open(path, framework="pt") as file:
            header = json.loads(file.metadata()["sfsnet_dr"])
        labels = NormalLabels(
            header["name"], header["subject"], tuple(header["lights"]), tuple(header["files"]), **tensors
        )
    except (SafetensorError, TypeError, KeyError, ValueError) as error:
        raise InputError(f"{path}: no labels of a face ({' '.join(str(error).split())})") from error
    sizes = check_shape(f"{path}: image", labels.image, "N C S S", N=len(labels.lights))
    check_shape(f"{path}: normal", labels.normal, "3 S S", S=sizes["S"])
    return labels


#: Share of the heads whose skin must cover a pixel.
_COVERED: Final = 0.5
#: Share of a pixel that is skin where its normal is one head's.
_WHOLE: Final = 0.99


def mean_normals(folders: Folders) -> Tensor:
    """Mean of the heads' normals and of their mirror images, over their skin, (3, 128, 128) float32.

    Shorter than 1 where heads differ; 0 where fewer than half of them have skin. Heads of ``sfsnet-dr synth``
    turn as far up as down, so that their mean looks straight ahead.

    Raises:
        InputError: for folders without usable bundles.
    """
    total, cover = torch.zeros(3, FACE_SIZE, FACE_SIZE), torch.zeros(1, FACE_SIZE, FACE_SIZE)
    paths = [path for path, _ in list_bundles(folders)]
    for path in paths:
        normal, skin = _in_frame(path)
        total += normal
        cover += skin
    total, cover = total + mirror_normal(total), cover + cover.flip(-1)
    known = cover >= 2 * _COVERED * len(paths)
    return torch.where(known, total / cover.clamp_min(1e-6), torch.zeros(()))


def head_normals(
    folders: Folders, most: int
) -> Iterator[tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]]:
    """Normals of single heads, of any length (128, 128, 3), and where they are known (128, 128).

    Args:
        folders: what ``sfsnet-dr synth`` wrote.
        most: no more than so many, evenly out of all.

    Raises:
        InputError: for folders without usable bundles.
    """
    paths = [path for path, _ in list_bundles(folders)]
    for path in paths[:: -(-len(paths) // most)]:
        normal, skin = _in_frame(path)
        yield normal.movedim(0, -1).double().numpy(), skin[0].numpy() > _WHOLE


def _in_frame(path: Path) -> tuple[Tensor, Tensor]:
    """A bundle's normals times its skin (3, 128, 128), and its skin (1, 128, 128)."""
    bundle = read_bundle(path)
    skin = torch.from_numpy(bundle.mask)[None].float()
    frame = Crop(skin.shape[-1])
    normal = torch.from_numpy(bundle.normal).movedim(-1, 0).float() * skin
    return frame.invert(normal, FACE_SIZE), frame.invert(skin, FACE_SIZE)
