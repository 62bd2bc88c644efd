"""Plots: they are drawn, they are repeatable, and the arithmetic under them is right."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from sfsnet_dr.report.plots import error_map, loss_curve, running_mean, signed_colours, spread_labels


def pixels(png: bytes) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def test_running_mean_is_the_mean_of_the_last_values() -> None:
    values = np.random.default_rng(0).normal(size=20)
    expected = [values[max(0, i - 4) : i + 1].mean() for i in range(20)]
    np.testing.assert_allclose(running_mean(values, 5), expected, rtol=1e-12)


def test_spread_keeps_the_gap_and_moves_no_more_than_needed() -> None:
    assert spread_labels([0.0, 1.0], 0.1) == [0.0, 1.0]
    np.testing.assert_allclose(spread_labels([0.5, 0.5], 0.1), [0.45, 0.55])
    np.testing.assert_allclose(spread_labels([0.1, 0.5, 0.51, 0.52], 0.1), [0.1, 0.41, 0.51, 0.61])
    placed = np.array(spread_labels(sorted(np.random.default_rng(1).uniform(size=9)), 0.1))
    assert np.diff(placed).min() > 0.1 - 1e-12


@pytest.mark.parametrize("names", [["total"], ["total", "recon", "normal", "albedo", "light"]])
def test_loss_curve_draws_and_repeats(names: list[str]) -> None:
    steps = list(range(0, 200, 2))
    terms = {name: [0.9 / (1 + i + 0.05 * s) for s in steps] for i, name in enumerate(names)}
    picture = loss_curve(steps, terms)
    assert picture == loss_curve(steps, terms)
    assert np.unique(pixels(picture).reshape(-1, 3), axis=0).shape[0] > 20


def test_error_map_leaves_missing_pixels_white() -> None:
    values = np.full((16, 16), np.nan)
    values[4:12, 4:12] = 1.0
    inner = pixels(error_map(values, label="error [%]", limit=1.0))
    empty = pixels(error_map(np.full((16, 16), np.nan), label="error [%]", limit=1.0))
    assert (inner != empty).any(axis=-1).mean() > 0.05


def test_signed_colours_are_red_above_blue_below_and_white_where_nothing_is() -> None:
    above, below, none = signed_colours(np.array([[0.2, -0.2, np.nan]]), limit=0.1)[0]
    assert above[0] > above[2] + 50
    assert below[2] > below[0] + 50
    assert (none == 255).all()
