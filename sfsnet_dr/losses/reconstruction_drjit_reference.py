"""The reconstruction loss as one Dr.Jit kernel over all pixels of a batch, wrapped for torch.

Plain version: no image is ever stored, and the light's gradient is summed by ``drjit_layout.spread``.
"""

from __future__ import annotations

from typing import Any

from sfsnet_dr.render.drjit_interop import from_torch, spread_values, torch_planes
from sfsnet_dr.render.shading_drjit_reference import render_planes
from sfsnet_dr.scene.jit import dr


def _kernel(normal: Any, albedo: Any, light: Any, image: Any, mask: Any) -> Any:
    pixels = normal.shape[2] * normal.shape[3]
    rendered = render_planes(torch_planes(normal), torch_planes(albedo), spread_values(light, pixels))
    red, green, blue = (dr.abs(i - r) for i, r in zip(torch_planes(image), rendered, strict=True))
    total = dr.sum((red + green + blue) * mask.array)  # one channel: its memory is a plane already
    return type(normal)(total, shape=())


#: Sum of mask |image - f_render|: torch tensors of one dtype in, a scalar tensor out; shapes as
#: ``reconstruction_l1`` after broadcasting.
masked_l1_sum = from_torch(_kernel)
