"""Bringing a photograph into the range of exposures that networks are trained on.

A camera meters the whole picture; a database with fixed lamps does not meter at all, and a face lit from the
side is then ten times darker than anything in training. Scaling linear light changes neither normals nor
albedo, and the light's coefficients follow.
"""

from __future__ import annotations

from typing import Final

from torch import Tensor

from sfsnet_dr.base.color import LUMINANCE

#: Mean linear luminance of a face's pixels that is left as it is. Four in five of 300 photographs lie within;
#: their median is .30, their 5th and 95th percentiles are .13 and .46.
USUAL: Final = (0.1, 0.4)


def metering_gain(images: Tensor, masks: Tensor) -> Tensor:
    """Factors that bring faces into the usual range of exposures.

    Args:
        images: linear Rec. 709, (B, 3, H, W).
        masks: share of each pixel that is skin, (B, 1, H, W).

    Returns:
        (B, 1, 1, 1); 1 for faces within ``USUAL`` and for images without a face or without light.
    """
    weights = images.new_tensor(LUMINANCE)[:, None, None]
    luminance = (images * weights).sum(1, keepdim=True)
    total = masks.sum((1, 2, 3), keepdim=True)
    mean = (luminance * masks).sum((1, 2, 3), keepdim=True) / total.clamp_min(1e-6)
    gain = mean.clamp(*USUAL) / mean.clamp_min(1e-6)
    return gain.where((total > 0) & (mean > 1e-6), gain.new_ones(()))
