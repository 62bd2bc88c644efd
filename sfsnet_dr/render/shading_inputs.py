"""The one contract on shapes that the three forms of the shading model share."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

from sfsnet_dr.base.checks import BadInput, check_shape

COLOURS: Final = 3

#: Numbers that an image batch may hold in one call: indices of 32 bits reach no further.
MAX_ELEMENTS: Final = 2**31 - 1


class RenderSizes(NamedTuple):
    """What the shapes of one call to a shading model say."""

    batch: int
    height: int
    width: int
    order: int


def light_order(light: Any, max_order: int) -> int:
    """The SH order of flat shading coefficients, from their count 3 (order + 1)^2.

    Args:
        light: anything with a ``shape``, (B, 3K).
        max_order: highest order that the caller can evaluate.

    Raises:
        BadInput: if the count belongs to no order from 0 to ``max_order``.
    """
    count = check_shape("light", light, "B N")["N"]
    order = math.isqrt(max(count, 0) // COLOURS) - 1
    if not 0 <= order <= max_order or COLOURS * (order + 1) ** 2 != count:
        allowed = ", ".join(str(COLOURS * (o + 1) ** 2) for o in range(max_order + 1))
        raise BadInput(f"light: {count} coefficients an image found, one of {allowed} expected (3 colours)")
    return order


def render_sizes(normal: Any, light: Any, albedo: Any | None = None, *, max_order: int) -> RenderSizes:
    """Check the shapes of one call and find the batch size that they broadcast to.

    Args:
        normal: (B, 3, H, W) or (1, 3, H, W).
        light: (B, 3K) or (1, 3K).
        albedo: (B, 3, H, W), (1, 3, H, W) or nothing.
        max_order: highest SH order that the caller can evaluate.

    Raises:
        BadInput: naming the argument whose shape does not fit.
    """
    sizes = check_shape("normal", normal, "B 3 H W")
    height, width = sizes["H"], sizes["W"]
    order = light_order(light, max_order)
    batches = {"normal": sizes["B"], "light": int(light.shape[0])}
    if albedo is not None:
        batches["albedo"] = check_shape("albedo", albedo, "B 3 H W", H=height, W=width)["B"]
    if 0 in (*batches.values(), height, width):
        raise BadInput(f"normal: shape {tuple(normal.shape)} found, no empty dimension or batch allowed")
    batch = max(batches.values())
    for name, size in batches.items():
        if size not in (1, batch):
            shape = tuple({"normal": normal, "light": light, "albedo": albedo}[name].shape)
            raise BadInput(f"{name}: shape {shape} found, a batch of {batch} or of 1 expected")
    if COLOURS * batch * height * width > MAX_ELEMENTS:
        raise BadInput(
            f"normal: {batch} images of {height} x {width} found, at most {MAX_ELEMENTS} numbers "
            "(3 a pixel) are allowed in one call; split the batch"
        )
    return RenderSizes(batch, height, width, order)
