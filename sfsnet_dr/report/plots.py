"""Plots for pages, as PNG bytes, from numbers that are already measured."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray

INK, SOFT, GRID = "#1c2024", "#5d666f", "#e3e6ea"

#: Colours that stay apart for colour-blind readers and in grey (Okabe and Ito, yellow left out).
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")

#: Matplotlib's settings for every plot.
STYLE: dict[Any, Any] = {
    "font.size": 11,
    "axes.edgecolor": SOFT,
    "axes.labelcolor": SOFT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "text.color": INK,
    "lines.linewidth": 1.8,
    "figure.facecolor": "white",
}


def loss_curve(steps: Sequence[int], terms: Mapping[str, Sequence[float]], *, window: int = 0) -> bytes:
    """Losses over training steps on a logarithmic axis: each value faint, a running mean on top.

    Args:
        steps: step numbers, (N,).
        terms: name -> losses (N,), positive; the first one is drawn strongest.
        window: steps of the running mean; 0 takes a twentieth of the run.
    """
    window = window or max(1, len(steps) // 20)
    with matplotlib.rc_context(STYLE):
        figure, axes = _axes(6.8, 4.0)
        axes.set_yscale("log")
        ends = []
        for index, (name, values) in enumerate(terms.items()):
            colour = PALETTE[index % len(PALETTE)]
            smooth = running_mean(np.asarray(values, dtype=np.float64), window)
            axes.plot(steps, values, color=colour, alpha=0.18, linewidth=0.8)
            axes.plot(steps, smooth, color=colour, linewidth=2.6 if index == 0 else 1.6)
            ends.append((float(smooth[-1]), name, colour))
        axes.set_xlim(steps[0], steps[-1])
        axes.set_xlabel("training step")
        axes.set_ylabel("loss")
        plain_log(axes.yaxis, "{:g}".format)
        _label_ends(axes, ends)
        return figure_png(figure)


def draw_histogram(values: Sequence[float], *, label: str, bins: Sequence[float], counted: str) -> bytes:
    """Bars of how many values fall between neighbouring bins.

    Args:
        values: the numbers; those outside all bins are counted in the first or the last.
        label: what they are, with the unit.
        bins: edges, increasing.
        counted: what has the values, in the plural.
    """
    with matplotlib.rc_context(STYLE):
        figure, axes = _axes(6.8, 3.2)
        axes.hist(np.clip(values, bins[0], bins[-1]), bins=list(bins), color=PALETTE[0], rwidth=0.92)
        axes.grid(visible=False, axis="x")
        axes.yaxis.get_major_locator().set_params(integer=True)
        axes.set_xlabel(label)
        axes.set_ylabel(counted)
        return figure_png(figure)


def error_map(values: NDArray[np.floating], *, label: str, limit: float, signed: bool = False) -> bytes:
    """A map (H, W) in colours with its scale; NaN pixels stay white.

    Args:
        values: the numbers, NaN where there is nothing to show.
        label: what they are, with the unit.
        limit: the value at the end of the scale; larger ones take its colour.
        signed: whether the scale runs from -limit to limit instead of from 0.
    """
    with matplotlib.rc_context(STYLE | {"axes.grid": False}):
        figure, axes = _axes(4.4, 3.8)
        axes.set_axis_off()
        picture = axes.imshow(
            values,
            cmap="RdBu_r" if signed else "magma_r",
            vmin=-limit if signed else 0.0,
            vmax=limit,
            interpolation="nearest",
        )
        bar = figure.colorbar(picture, ax=axes, fraction=0.045, pad=0.03, extend="both" if signed else "max")
        bar.outline.set_visible(False)
        bar.set_label(label)
        return figure_png(figure)


def signed_colours(values: NDArray[np.floating], limit: float) -> NDArray[np.uint8]:
    """A map (H, W) as pixels (H, W, 3): red above 0, blue below, full colour at ``limit``; NaN is white."""
    shown = matplotlib.colormaps["RdBu_r"](0.5 + 0.5 * np.clip(np.nan_to_num(values) / limit, -1.0, 1.0))
    pixels = np.where(np.isnan(values)[..., None], 1.0, np.asarray(shown)[..., :3])
    return np.asarray(np.round(255 * pixels), dtype=np.uint8)


def error_colours(values: NDArray[np.floating], limit: float) -> NDArray[np.uint8]:
    """A map (H, W) as pixels (H, W, 3): light where 0, dark at ``limit`` and above; NaN is white."""
    shown = matplotlib.colormaps["magma_r"](np.clip(np.nan_to_num(values) / limit, 0.0, 1.0))
    pixels = np.where(np.isnan(values)[..., None], 1.0, np.asarray(shown)[..., :3])
    return np.asarray(np.round(255 * pixels), dtype=np.uint8)


#: Height of a line of a legend in inches, for a figure must hold all of them.
_LEGEND_LINE: Final = 0.24


def lines_by_group(
    groups: Sequence[str], lines: Mapping[str, Sequence[float | None]], *, label: str, groups_label: str = ""
) -> bytes:
    """A line with dots for each name over groups that stand in a row; None leaves a gap.

    Args:
        groups: their names, (N,).
        lines: name -> values (N,).
        label: what the values are, with the unit.
        groups_label: what the groups are.
    """
    with matplotlib.rc_context(STYLE):
        figure, axes = _axes(9.2, max(3.8, 0.5 + _LEGEND_LINE * len(lines)))
        for index, (name, values) in enumerate(lines.items()):
            shown = [np.nan if value is None else value for value in values]
            style = ("-", "--", ":", "-.")[index // len(PALETTE) % 4]
            axes.plot(
                range(len(groups)), shown, style, color=PALETTE[index % len(PALETTE)], marker="o", label=name
            )
        axes.set_xticks(range(len(groups)), groups)
        axes.grid(visible=False, axis="x")
        axes.set_ylim(bottom=0)
        axes.set_ylabel(label)
        axes.set_xlabel(groups_label)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
        return figure_png(figure)


def running_mean(values: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    """Mean over the last ``window`` values, over fewer at the start; (N,) to (N,)."""
    total = np.concatenate(([0.0], np.cumsum(values)))
    last = np.arange(1, len(values) + 1)
    first = np.maximum(last - window, 0)
    return np.asarray((total[last] - total[first]) / (last - first), dtype=np.float64)


def spread_labels(positions: Sequence[float], gap: float) -> list[float]:
    """Move sorted positions apart as little as needed so that neighbours differ by at least ``gap``."""
    placed: list[list[float]] = []  # groups of positions that touch: [sum of anchors, count]
    for index, position in enumerate(positions):
        placed.append([position - index * gap, 1.0])
        while len(placed) > 1 and placed[-2][0] / placed[-2][1] > placed[-1][0] / placed[-1][1]:
            anchor, count = placed.pop()
            placed[-1][0] += anchor
            placed[-1][1] += count
    anchors = [anchor / count for anchor, count in placed for _ in range(int(count))]
    return [anchor + index * gap for index, anchor in enumerate(anchors)]


def _axes(width: float, height: float) -> tuple[Any, Any]:
    figure = Figure(figsize=(width, height), dpi=192, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()


def plain_log(axis: Any, text: Callable[[float], str]) -> None:
    """Label a logarithmic axis in plain numbers: decades, and 2 and 5 between them where it spans few."""
    low, high = axis.get_view_interval()
    between = (1.0, 2.0, 5.0) if high / low < 200 else (1.0,)
    axis.set_major_locator(LogLocator(subs=between))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: text(value)))


def _label_ends(axes: Any, ends: Sequence[tuple[float, str, str]]) -> None:
    """Write each line's name at its right end, moved apart where they would touch."""
    low, high = np.log10(axes.get_ylim())
    ordered = sorted(ends)
    heights = [(np.log10(value) - low) / (high - low) for value, _, _ in ordered]
    for place, (_, name, colour) in zip(spread_labels(heights, 0.065), ordered, strict=True):
        axes.text(1.015, place, name, transform=axes.transAxes, color=colour, va="center", clip_on=False)


def figure_png(figure: Any) -> bytes:
    """A figure as a PNG file without dates, so that equal figures are equal bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


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
        return figure_png(figure)


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
        return figure_png(figure)


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
