"""The plot of error against time: its front, its colours, its labels."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.image import imread

from sfsnet_dr.report.pareto import TimedError, pareto_front, pareto_plot

POINTS = [
    TimedError("order 2", "SH", 1e-3, 2e-2, (1.5e-2, 2.6e-2)),
    TimedError("order 4", "SH", 2e-3, 1e-2),
    TimedError("visibility", "SH", 3e-3, 1.5e-2),
    TimedError("64 paths", "path tracer", 0.4, 5e-2),
    TimedError("4096 paths", "path tracer", 20.0, 0.6e-2),
]


def test_the_front_holds_what_nothing_beats_in_both() -> None:
    assert [point.name for point in pareto_front(POINTS)] == ["order 2", "order 4", "4096 paths"]
    assert pareto_front([]) == []


def test_each_group_has_a_colour_and_points_without_error_are_left_out() -> None:
    picture = pareto_plot({"soft": [*POINTS, TimedError("exact", "closed form", 1e-3, 0.0)]})
    assert picture == pareto_plot({"soft": POINTS})
    shown = (imread(io.BytesIO(picture))[..., :3].reshape(-1, 3) * 255).round().astype(int)
    colours = {tuple(colour) for colour in np.unique(shown, axis=0).tolist()}
    assert (0x00, 0x72, 0xB2) in colours
    assert (0xD5, 0x5E, 0x00) in colours
    assert (0x00, 0x9E, 0x73) not in colours
