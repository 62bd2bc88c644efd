"""How maps are shown: 8-bit pictures for people, never for measuring."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True)
class SheetStyle:
    """Sizes of a sheet in pixels; ``text`` is that of labels in points of 1/72 of 100 pixels."""

    cell: int = 256
    gap: int = 20
    margin: int = 28
    label: int = 30
    title: int = 56
    text: int = 11
    ink: str = "#1c2024"
    soft: str = "#5d666f"


def sheet(
    pictures: Sequence[tuple[str, Pixels]],
    *,
    title: str = "",
    columns: int = 4,
    style: SheetStyle | None = None,
) -> bytes:
    """Pictures with labels under them, row by row, as one PNG.

    Args:
        pictures: (label, 8-bit picture (H, W, 3)) in reading order; at least one.
        title: a line above them, or nothing.
        columns: pictures a row.
        style: sizes and colours.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    style = style or SheetStyle()
    columns = min(columns, len(pictures))
    rows = -(-len(pictures) // columns)
    pitch_x, pitch_y = style.cell + style.gap, style.cell + style.label + style.gap
    width = 2 * style.margin + columns * pitch_x - style.gap
    top = style.margin + (style.title if title else 0)
    height = top + rows * pitch_y - style.gap + style.margin
    with matplotlib.rc_context({"font.family": "sans-serif"}):
        figure = Figure(figsize=(width / 100, height / 100), dpi=100, facecolor="white")
        FigureCanvasAgg(figure)
        if title:
            figure.text(
                style.margin / width,
                1 - style.margin / height,
                title,
                size=15,
                color=style.ink,
                weight="bold",
                va="top",
            )
        for index, (label, picture) in enumerate(pictures):
            x = style.margin + (index % columns) * pitch_x
            y = height - top - (index // columns) * pitch_y - style.cell
            box = (x / width, y / height, style.cell / width, style.cell / height)
            axes = figure.add_axes(box)
            axes.set_axis_off()
            exact = style.cell % max(picture.shape[:2]) == 0
            axes.imshow(picture, interpolation="nearest" if exact else "lanczos")
            figure.text(x / width, (y - 9) / height, label, size=style.text, color=style.soft, va="top")
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", facecolor="white", metadata={"Software": None})
    return buffer.getvalue()


def _quantise(values: Array) -> Pixels:
    return np.asarray(np.round(np.clip(values, 0.0, 1.0) * 255.0), dtype=np.uint8)
