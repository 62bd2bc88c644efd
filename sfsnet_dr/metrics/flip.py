"""FLIP, a perceptual difference of images (Andersson et al. 2020), where ``flip-evaluator`` is installed."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.checks import BadInput, check_shape

#: How to get it: it is optional, because it only reports.
INSTALL: Final = "pip install flip-evaluator"


def has_flip() -> bool:
    """Whether the optional package is there."""
    return find_spec("flip_evaluator") is not None


def flip(image: npt.ArrayLike, reference: npt.ArrayLike, mask: npt.ArrayLike) -> float:
    """Mean of the FLIP map over a mask, 0 (equal) to 1, for a viewer at 67 pixels a degree.

    What lies outside the mask is made equal in both images.

    Args:
        image: (H, W, 3) linear; clipped to [0, 1] and encoded as sRGB.
        reference: the same shape.
        mask: (H, W), weights from 0 to 1.

    Raises:
        BadInput: for other shapes, an empty mask, or where the package is missing.
    """
    if not has_flip():
        raise BadInput(f"FLIP: not installed; {INSTALL}")
    import flip_evaluator

    from sfsnet_dr.base.color import linear_to_srgb

    pair = [np.asarray(values, dtype=np.float64) for values in (reference, image)]
    weight = np.asarray(mask, dtype=np.float64)
    sizes = check_shape("image", pair[1], "H W 3")
    check_shape("reference", pair[0], "H W 3", **sizes)
    check_shape("mask", weight, "H W", **sizes)
    if weight.sum() <= 0:
        raise BadInput("mask: empty, at least one pixel expected")
    shown = [
        np.asarray(linear_to_srgb(np.clip(values, 0, 1)) * (weight[..., None] > 0), dtype=np.float32)
        for values in pair
    ]
    map_, _, _ = flip_evaluator.evaluate(*shown, "LDR", applyMagma=False, computeMeanError=False)
    return float((np.asarray(map_)[..., 0] * weight).sum() / weight.sum())
