"""How rendered heads face on average: what says which way is straight ahead where no lamp is known."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor

from sfsnet_dr.base.conventions import FACE_SIZE
from sfsnet_dr.data.bundle import read_bundle
from sfsnet_dr.data.dataset import Folders, listed
from sfsnet_dr.data.flip import flip_normal
from sfsnet_dr.data.view import View

#: Share of the heads whose skin must cover a pixel.
_COVERED: Final = 0.5


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
        bundle = read_bundle(path)
        skin = torch.from_numpy(bundle.mask)[None].float()
        normal = torch.from_numpy(bundle.normal).movedim(-1, 0).float() * skin
        frame = View(skin.shape[-1])
        total += frame.spread(normal, FACE_SIZE)
        cover += frame.spread(skin, FACE_SIZE)
    total, cover = total + flip_normal(total), cover + cover.flip(-1)
    known = cover >= 2 * _COVERED * len(paths)
    return torch.where(known, total / cover.clamp_min(1e-6), torch.zeros(()))
