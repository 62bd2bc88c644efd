"""Noise against time, as lines of one plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sfsnet_dr.report.figures import INK, PALETTE, STYLE, plain_log, png


def noise_plot(lines: Mapping[str, Sequence[tuple[float, float, str]]], *, label: str) -> bytes:
    """Noise against seconds, both logarithmic; down and to the left is better.

    Args:
        lines: name -> points of seconds, relative noise and a word beside the point, which may be empty.
        label: of the vertical axis.

    Returns:
        A PNG.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 4.4), dpi=192, layout="constrained")
        FigureCanvasAgg(figure)
        axis = figure.add_subplot()
        axis.set_xscale("log")
        axis.set_yscale("log")
        for (name, points), colour in zip(lines.items(), PALETTE, strict=False):
            x, y = [point[0] for point in points], [point[1] for point in points]
            axis.plot(x, y, color=colour, marker="o", markersize=5, linewidth=1.4, label=name)
            for seconds, noise, word in points:
                axis.annotate(
                    word, (seconds, noise), xytext=(-6, -12), textcoords="offset points", size=9.5,
                    color=colour, ha="right",
                )  # fmt: skip
        axis.margins(x=0.12, y=0.12)
        axis.set_xlabel("seconds for one face")
        axis.set_ylabel(label)
        plain_log(axis.xaxis, "{:g}".format)
        plain_log(axis.yaxis, lambda ratio: f"{100 * ratio:g} %")
        axis.legend(frameon=False, fontsize=10, labelcolor=INK)
        return png(figure)
