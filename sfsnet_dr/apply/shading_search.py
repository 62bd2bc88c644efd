"""The baseline "sirfs": shape, albedo and light of each image by optimisation under priors."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from sfsnet_dr.apply.methods import Answer, divided
from sfsnet_dr.base.color import LUMINANCE
from sfsnet_dr.fit.intrinsic import IntrinsicOptions, solve_intrinsic
from sfsnet_dr.render.shading_torch import shading, unit


class ShadingSearch:
    """``fit.intrinsic`` as a method; its normals are interpolated to the image's size.

    The light has no tint: what tint there is becomes the albedo's, whose luminance is .5 on average.

    Args:
        options: of the optimiser; those found on rendered faces if left out.

    Raises:
        BadInput: when called, for an image that is black or a mask that is empty.
    """

    name = "sirfs"

    def __init__(self, options: IntrinsicOptions | None = None) -> None:
        self.options = options or IntrinsicOptions()

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Answer:
        """See ``Method``."""
        found = solve_intrinsic(images, masks, self.options)
        size = images.shape[-1]
        grown = functional.interpolate(found.normal, (size, size), mode="bilinear", align_corners=False)
        normal = unit(grown)
        shown = (masks * shading(normal, found.light.repeat(1, 3))).clamp_min(0).sum((1, 2, 3)) / 3
        weights = torch.tensor(LUMINANCE, dtype=images.dtype)[None, :, None, None]
        bright = (masks * images * weights).sum((1, 2, 3))
        level = bright / (0.5 * shown.clamp_min(1e-6))
        return divided(normal, (found.light * level[:, None]).repeat(1, 3), images)
