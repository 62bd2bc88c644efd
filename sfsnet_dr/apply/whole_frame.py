"""What a network says of the frame around the part that it was trained on.

A network that was shown the middle of the frame answers for that. Chins and foreheads of large faces lie
beyond; for these it is shown the whole frame with as many pixels, where faces are smaller than it is used to.
The two answers meet on a rim. The second one's albedo is scaled to the first one's, for how a network shares
brightness between albedo and light differs a little between the two; light is that of the first.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor

from sfsnet_dr.base.conventions import FACE_SIZE
from sfsnet_dr.data.view import View
from sfsnet_dr.model.outputs import Decomposition
from sfsnet_dr.render.shading_torch import unit

#: Pixels of the canonical frame over which one answer fades into the other, inside of the view.
RIM: Final = 6
#: Greatest factor between the two albedos that is believed.
_MOST: Final = 4.0


def beyond(masks: Tensor, view: View) -> Tensor:
    """Which of some masks (B, 1, H, W) reach out of the view, (B,) of bool."""
    return ((masks > 0.5) & (view.covered(masks.shape[-1]).to(masks.device) < 0.5)).flatten(1).any(1)


def joined(near: Decomposition, wide: Decomposition, masks: Tensor, view: View) -> Decomposition:
    """The answer for the view, and around it the answer for the whole frame.

    Args:
        near: for the view, its maps spread over the frame, (B, 3, H, W).
        wide: the same for the whole frame.
        masks: (B, 1, H, W); the two albedos are compared on their pixels within the view.
        view: what ``near`` was found from.

    Returns:
        Unit normals and albedo; the light of ``near``.
    """
    share = _share(view, masks.shape[-1]).to(masks)
    both = masks * view.covered(masks.shape[-1]).to(masks)
    sums = [(both * part.albedo).flatten(1).sum(1).clamp_min(1e-6) for part in (near, wide)]
    factor = (sums[0] / sums[1]).clamp(1 / _MOST, _MOST)[:, None, None, None]
    return Decomposition(
        unit(share * near.normal + (1 - share) * wide.normal),
        share * near.albedo + (1 - share) * factor * wide.albedo,
        near.light,
    )


def _share(view: View, pixels: int) -> Tensor:
    """(N, N): 1 within the view, 0 beyond it, falling over ``RIM`` pixels of the frame before its edges."""
    edge = view.crop / FACE_SIZE / 2
    place = ((torch.arange(pixels) + 0.5) / pixels - 0.5).abs()
    ramp = ((edge - place) * FACE_SIZE / RIM).clamp(0, 1)
    return ramp[:, None] * ramp[None, :]
