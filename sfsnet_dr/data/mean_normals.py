"""How rendered heads face on average, and how steep they are: what tells both where no lamp is known."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from sfsnet_dr.base.conventions import FACE_SIZE
from sfsnet_dr.data.bundle import read_bundle
from sfsnet_dr.data.dataset import Folders, listed
from sfsnet_dr.data.flip import flip_normal
from sfsnet_dr.data.view import View

#: Share of the heads whose skin must cover a pixel.
_COVERED: Final = 0.5
#: Share of a pixel that is skin where its normal is one head's.
_WHOLE: Final = 0.99


def mean_normals(folders: Folders) -> Tensor:
    """Mean of the heads' normals and of their mirror images, over their skin, (3, 128, 128) float32.

    Shorter than 1 where heads differ; 0 where fewer than half of them have skin. Heads of ``sfsnet-dr synth``
    turn as far up as down, so that their mean looks straight ahead.

    Raises:
        BadInput: for folders without usable bundles.
    """
    total, cover = torch.zeros(3, FACE_SIZE, FACE_SIZE), torch.zeros(1, FACE_SIZE, FACE_SIZE)
    paths = [path for path, _ in listed(folders)]
    for path in paths:
        normal, skin = _in_frame(path)
        total += normal
        cover += skin
    total, cover = total + flip_normal(total), cover + cover.flip(-1)
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
        BadInput: for folders without usable bundles.
    """
    paths = [path for path, _ in listed(folders)]
    for path in paths[:: -(-len(paths) // most)]:
        normal, skin = _in_frame(path)
        yield normal.movedim(0, -1).double().numpy(), skin[0].numpy() > _WHOLE


def _in_frame(path: Path) -> tuple[Tensor, Tensor]:
    """A bundle's normals times its skin (3, 128, 128), and its skin (1, 128, 128)."""
    bundle = read_bundle(path)
    skin = torch.from_numpy(bundle.mask)[None].float()
    frame = View(skin.shape[-1])
    normal = torch.from_numpy(bundle.normal).movedim(-1, 0).float() * skin
    return frame.spread(normal, FACE_SIZE), frame.spread(skin, FACE_SIZE)
