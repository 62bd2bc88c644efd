"""Error against time, both logarithmic, with the front of what nothing beats in both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from sfsnet_dr.report.plots import INK, PALETTE, SOFT, STYLE, figure_png, plain_log, spread_labels

#: From a label's left end to its point.
_LEADER = {"arrowstyle": "-", "linewidth": 0.6, "shrinkA": 1, "shrinkB": 4, "relpos": (0.0, 0.5)}

#: Points of a group whose errors differ by no more than this ratio share one label.
_SAME = 1.02


@dataclass(frozen=True)
class TimedError:
    """One renderer's place in the plot of error against time.

    Attributes:
        name: label beside the point.
        group: points of one group share a colour.
        seconds: time of one image, positive.
        error: relative error, positive.
        interval: ends of the error's interval, or None.
    """

    name: str
    group: str
    seconds: float
    error: float
    interval: tuple[float, float] | None = None


def pareto_plot(
    panels: Mapping[str, Sequence[TimedError]], *, error_label: str = "relative RMS error"
) -> bytes:
    """One panel for each kind of light: points by group, the front as a line. Down and left is better.

    Args:
        panels: title -> points. Points of one group share a colour; equal ones share a label.
        error_label: of the vertical axis.

    Returns:
        A PNG.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(5.4 * len(panels) + 0.6, 5.0), dpi=160, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        groups = list(dict.fromkeys(point.group for points in panels.values() for point in points))
        colours = {group: PALETTE[k % len(PALETTE)] for k, group in enumerate(groups)}
        for k, (axis, (title, points)) in enumerate(zip(axes, panels.items(), strict=True)):
            _panel(axis, title, [point for point in points if point.error > 0], colours)
            if k == 0:
                axis.set_ylabel(error_label)
        for axis in axes:
            _labels(axis, colours)
        handles = {h.get_label(): h for axis in axes for h in axis.get_legend_handles_labels()[0]}
        figure.legend(
            handles=list(handles.values()), loc="outside lower center", ncols=3, frameon=False, fontsize=10
        )
        return figure_png(figure)


def pareto_front(points: Sequence[TimedError]) -> list[TimedError]:
    """The points that no other one beats in time and in error, by time."""
    best: list[TimedError] = []
    for point in sorted(points, key=lambda point: (point.seconds, point.error)):
        if not best or point.error < best[-1].error:
            best.append(point)
    return best


def _panel(axis: Any, title: str, points: list[TimedError], colours: Mapping[str, str]) -> None:
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_title(title, fontsize=11, color=INK)
    steps = pareto_front(points)
    axis.step(
        [point.seconds for point in steps], [point.error for point in steps], where="post", color=SOFT,
        linewidth=1.0, linestyle=(0, (4, 3)), zorder=1, label="front: nothing is better in both",
    )  # fmt: skip
    for group in dict.fromkeys(point.group for point in points):
        mine = [point for point in points if point.group == group]
        axis.errorbar(
            [p.seconds for p in mine], [p.error for p in mine], yerr=_bars(mine), color=colours[group],
            marker="o", markersize=6, capsize=2, linestyle="none", elinewidth=1.0, label=group, zorder=3,
        )  # fmt: skip
    axis.margins(x=0.22, y=0.08)
    axis.set_xlabel("time of one image, warm")
    plain_log(axis.xaxis, _time)
    plain_log(axis.yaxis, lambda ratio: f"{100 * ratio:g} %")
    axis.points_to_label = points


def _labels(axis: Any, colours: Mapping[str, str]) -> None:
    """Names right of their points, moved apart up and down where they would touch."""
    figure = axis.get_figure()
    figure.draw_without_rendering()
    merged = sorted(_merged(axis.points_to_label), key=lambda item: item[1].error)
    places = [
        axis.transAxes.inverted().transform(axis.transData.transform((p.seconds, p.error))) for _, p in merged
    ]
    for column in (False, True):  # the left and the right half are kept apart each by itself
        chosen = [k for k, (x, _) in enumerate(places) if (x > 0.5) == column]
        heights = spread_labels([float(places[k][1]) for k in chosen], 0.045)
        right = max((float(places[k][0]) for k in chosen), default=0.0)
        halo = [withStroke(linewidth=3, foreground="white")]  # the front may run behind a label
        for k, height in zip(chosen, heights, strict=True):
            name, point = merged[k]
            x = float(places[k][0]) if column else right
            axis.annotate(
                name, (point.seconds, point.error), xytext=(x + 0.04, height), textcoords=axis.transAxes,
                size=8.5, color=colours[point.group], va="center", path_effects=halo,
                arrowprops=_LEADER | {"color": colours[point.group]},
            )  # fmt: skip


def _merged(points: Sequence[TimedError]) -> list[tuple[str, TimedError]]:
    """Labels, those of points that lie on each other put together: ``order 2, order 3``."""
    found: list[tuple[str, TimedError]] = []
    for point in points:
        for k, (name, other) in enumerate(found):
            near = 1 / _SAME < point.error / other.error < _SAME
            if near and point.group == other.group and point.seconds < 3 * other.seconds:
                found[k] = (f"{name}, {point.name.removeprefix('order ')}", other)
                break
        else:
            found.append((point.name, point))
    return found


def _time(seconds: float) -> str:
    if seconds > 0.999:
        return f"{seconds:g} s"
    return f"{1e3 * seconds:g} ms" if seconds > 0.999e-3 else f"{1e6 * seconds:g} \u00b5s"


def _bars(points: Sequence[TimedError]) -> list[list[float]]:
    ends = [point.interval or (point.error, point.error) for point in points]
    low = [max(p.error - max(lo, 0.02 * p.error), 0.0) for p, (lo, _) in zip(points, ends, strict=True)]
    return [low, [max(hi - p.error, 0.0) for p, (_, hi) in zip(points, ends, strict=True)]]
