"""Parts of a face in the canonical frame, for errors by region."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_fill_holes, distance_transform_edt

from sfsnet_dr.base.conventions import EYE_DISTANCE, EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT, FACE_SIZE

Mask = npt.NDArray[np.bool_]

REGIONS: Final = ("forehead", "eyes", "nose", "cheeks", "mouth and chin", "outline")

#: Bounds in distances between the eyes, from the point between them: x to either side, y downward.
_BROWS: Final = -0.27
_BELOW_EYES: Final = 0.25
_BELOW_NOSE: Final = 0.83
_BRIDGE: Final = 0.18
_NOSE: Final = 0.32
_MOUTH: Final = 0.58
#: Width of the outline in shares of the frame.
_RIM: Final = 5 / 128


def face_regions(mask: npt.ArrayLike) -> dict[str, Mask]:
    """Which pixels of a mask (H, W) belong to which region; each belongs to one.

    Everybody's eyes are at the same places in this frame, so lines at fixed distances from them divide an
    upright face: brows and eyes with the lids; the nose with its bridge; mouth and chin between the corners
    of the mouth. The outline is what lies within 4 % of the frame's width of the mask's outer end, be it the
    face's or the photograph's, and is taken first.
    """
    skin = np.asarray(mask) > 0.5
    size = skin.shape[0]
    place = (np.arange(size) + 0.5) * FACE_SIZE / size
    middle = (EYE_IMAGE_LEFT[0] + EYE_IMAGE_RIGHT[0]) / 2
    x = np.abs(place - middle)[None, :] / EYE_DISTANCE + np.zeros((size, 1))
    y = (place - EYE_IMAGE_LEFT[1])[:, None] / EYE_DISTANCE + np.zeros((1, size))
    whole = np.pad(binary_fill_holes(skin), 1)
    rim = distance_transform_edt(whole)[1:-1, 1:-1] <= _RIM * size
    nose = (y >= _BROWS) & (y < _BELOW_NOSE) & (x < np.where(y < _BELOW_EYES, _BRIDGE, _NOSE))
    parts = {
        "forehead": y < _BROWS,
        "eyes": (y >= _BROWS) & (y < _BELOW_EYES) & ~nose,
        "nose": nose,
        "mouth and chin": (y >= _BELOW_NOSE) & (x < _MOUTH),
    }
    rest = ~np.any(list(parts.values()), axis=0)
    found = {name: part & skin & ~rim for name, part in (parts | {"cheeks": rest}).items()}
    found["outline"] = skin & rim
    return {name: found[name] for name in REGIONS}
