"""Pictures of lights: values over all directions, and images under a light beside the model's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from sfsnet_dr.report.plots import INK, SOFT, STYLE, figure_png

Array = NDArray[np.float64]

_DISK = 200  # pixels across a hemisphere


@dataclass(frozen=True)
class Panel:
    """A picture in a row.

    Attributes:
        title: above it.
        picture: (H, W) numbers, drawn in colours from blue over white to red; or (H, W, 3) 8-bit.
        limit: number that is fully red; its negative is fully blue.
        label: beside the scale of the numbers; without one there is no scale.
    """

    title: str
    picture: NDArray[np.generic]
    limit: float = 1.0
    label: str = ""


def draw_panels(row: Sequence[Panel]) -> bytes:
    """Pictures side by side, all of one height."""
    with matplotlib.rc_context(STYLE | {"axes.grid": False}):
        widths = [panel.picture.shape[1] / panel.picture.shape[0] for panel in row]
        figure, axes = _row(widths, height=2.5)
        for place, panel in zip(axes, row, strict=True):
            place.set_axis_off()
            place.set_title(panel.title, size=10, color=SOFT)
            numbers = panel.picture.ndim == 2
            drawn = place.imshow(
                panel.picture,
                cmap="RdBu_r" if numbers else None,
                vmin=-panel.limit if numbers else None,
                vmax=panel.limit if numbers else None,
                interpolation="nearest",
            )
            if panel.label:
                bar = figure.colorbar(drawn, ax=place, fraction=0.046, pad=0.03, extend="both")
                bar.outline.set_visible(False)
                bar.set_label(panel.label, size=9)
        return figure_png(figure)


def draw_hemispheres(
    values: Array, directions: Array, *, label: str, limit: float, mark: Array | None = None
) -> bytes:
    """Values of directions on two disks: those before the subject and those behind it.

    Equal areas of a disk are equal solid angles. Right and up are the image's on both. The
    middle of the first is the viewer's direction, its edge a right angle to it; the middle of the second is
    straight behind.

    Args:
        values: (N,), NaN where there is none.
        directions: (N, 3) unit vectors.
        label: what the values are.
        limit: the value at the end of the scale.
        mark: (3,) a direction to be marked.
    """
    place = (np.arange(_DISK) + 0.5) / _DISK * 2 - 1
    x, y = np.meshgrid(place, -place)
    radius = np.hypot(x, y)
    height = 1 - np.minimum(radius, 1.0) ** 2  # of Lambert's azimuthal map of half a sphere
    across = np.sqrt(np.maximum(2 - radius**2, 0.0))
    with matplotlib.rc_context(STYLE | {"axes.grid": False}):
        figure, axes = _row([1.0, 1.0], height=3.6)
        for sign, name, disk in zip(
            (1, -1), ("light from the front", "light from behind"), axes, strict=True
        ):
            vectors = np.stack([x * across, y * across, sign * height], axis=-1)
            shown = np.where(radius <= 1, values[np.argmax(vectors @ directions.T, axis=-1)], np.nan)
            disk.set_axis_off()
            disk.set_title(name, size=11, color=SOFT)
            box = (-1.0, 1.0, -1.0, 1.0)
            drawn = disk.imshow(shown, cmap="magma_r", vmin=0.0, vmax=limit, extent=box)
            disk.add_patch(Circle((0, 0), 1.0, fill=False, color=SOFT, linewidth=0.8))
            if mark is not None and mark[2] * sign >= 0:
                at = mark[:2] / np.sqrt(1 + abs(mark[2]))
                disk.plot(*at, marker="o", markersize=11, fillstyle="none", color=INK)
                disk.plot(*at, marker="o", markersize=13, fillstyle="none", color="white", linewidth=0.6)
        bar = figure.colorbar(drawn, ax=list(axes), fraction=0.03, pad=0.02, extend="max")
        bar.outline.set_visible(False)
        bar.set_label(label)
        return figure_png(figure)


def _row(widths: Sequence[float], height: float) -> tuple[Any, Any]:
    """A figure of axes of given widths, relative to its height in inches."""
    figure = Figure(figsize=(height * sum(widths) + 1.2, height), dpi=192, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, np.atleast_1d(figure.subplots(1, len(widths), width_ratios=list(widths)))
