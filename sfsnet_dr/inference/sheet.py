"""Labelled pictures side by side, as one PNG."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

from sfsnet_dr.core.visualize import Pixels


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


def draw_sheet(
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
