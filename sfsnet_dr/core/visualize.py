"""Maps as 8-bit pictures for people to look at; nothing is measured on them."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.core import color
from sfsnet_dr.core.errors import check_shape

Pixels = NDArray[np.uint8]
Array = NDArray[np.floating]


def show_linear(image: Array) -> Pixels:
    """Linear Rec. 709 (H, W, 3) as 8-bit sRGB; values outside 0..1 are clipped."""
    check_shape("image", image, "H W 3")
    return _quantise(color.linear_to_srgb(np.clip(image, 0.0, 1.0)))


def show_albedo(albedo: Array, mask: Array) -> Pixels:
    """Albedo (H, W, 3) known up to a factor: all but the brightest 2 % of the masked pixels lie below 0.8."""
    top = float(np.quantile(albedo[mask > 0.5], 0.98))
    return show_linear(0.8 * albedo / max(top, 1e-6))


def show_encoded(image: Array) -> Pixels:
    """Numbers (H, W, 3) that are sRGB-encoded already, as they are; values outside 0..1 are clipped."""
    check_shape("image", image, "H W 3")
    return _quantise(image)


def show_normals(normal: Array) -> Pixels:
    """Unit vectors (H, W, 3) as the colours (n + 1) / 2: red to the right, green up, blue to the viewer."""
    check_shape("normal", normal, "H W 3")
    return _quantise((normal + 1.0) / 2.0)


def on_white(picture: Pixels, mask: Array) -> Pixels:
    """Fade a picture (H, W, 3) to white where the mask (H, W, values 0..1) is 0."""
    sizes = check_shape("picture", picture, "H W 3")
    check_shape("mask", mask, "H W", **sizes)
    weight = np.clip(mask, 0.0, 1.0)[..., None]
    return np.asarray(np.round(picture * weight + 255.0 * (1.0 - weight)), dtype=np.uint8)


def png_bytes(picture: Pixels) -> bytes:
    """An 8-bit picture (H, W, 3) as a PNG file without dates, so that equal pictures are equal bytes."""
    from PIL import Image

    check_shape("picture", picture, "H W 3")
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="png")
    return buffer.getvalue()


def _quantise(values: Array) -> Pixels:
    return np.asarray(np.round(np.clip(values, 0.0, 1.0) * 255.0), dtype=np.uint8)
