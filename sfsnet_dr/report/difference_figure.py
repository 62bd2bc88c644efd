"""Differences from a reference with their intervals, a row a name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sfsnet_dr.report.figures import INK, PALETTE, SOFT, STYLE, png


@dataclass(frozen=True)
class Difference:
    """One difference.

    Attributes:
        value: the number.
        ends: of its interval.
        each: what it is the mean of, drawn as small rings where there are several.
    """

    value: float
    ends: tuple[float, float]
    each: Sequence[float] = ()


def difference_plot(
    names: Sequence[str], kinds: Mapping[str, Mapping[str, Difference]], *, label: str
) -> bytes:
    """Dots with intervals beside a line at 0.

    Args:
        names: of the rows, from the top.
        kinds: what is told apart by colour -> row -> its difference; a row may be missing.
        label: of the axis, with the unit.

    Returns:
        A PNG.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.6, 1.2 + 0.5 * max(len(names), 2)), dpi=192, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        axes.axvline(0, color=SOFT, linewidth=1.2, zorder=1)
        for place, (kind, rows) in enumerate(kinds.items()):
            shift = 0.26 * (place - (len(kinds) - 1) / 2)
            _draw(axes, names, rows, shift, (kind, PALETTE[place % len(PALETTE)]))
        axes.set_yticks(range(len(names)), names, color=INK)
        axes.set_ylim(len(names) - 0.5, -0.5)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel(label)
        figure.legend(frameon=False, fontsize=10, labelcolor=INK, loc="outside upper left", ncols=len(kinds))
        return png(figure)


def _draw(
    axes: Any, names: Sequence[str], rows: Mapping[str, Difference], shift: float, look: tuple[str, str]
) -> None:
    kind, colour = look
    for name, row in rows.items():
        height = names.index(name) + shift
        axes.plot(row.ends, [height] * 2, color=colour, linewidth=2.2, solid_capstyle="round", zorder=2)
        if len(row.each) > 1:
            axes.plot(
                row.each, [height] * len(row.each), "o", markersize=4.5, markerfacecolor="white",
                markeredgecolor=colour, zorder=3,
            )  # fmt: skip
    places = [names.index(name) + shift for name in rows]
    values = [row.value for row in rows.values()]
    axes.plot(values, places, "o", color=colour, markersize=7, label=kind, zorder=4)
