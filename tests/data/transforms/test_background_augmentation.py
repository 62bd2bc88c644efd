"""Backgrounds, and which augmentations are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.transforms.background import Augmentation, render_backgrounds
from sfsnet_dr.scene.lights.spec import LightSpec


def many(seed: int = 0) -> torch.Tensor:
    """Backgrounds of 300 faces under white light of level 1, before a red place."""
    lit, place = np.ones((300, 3)), np.tile([2.0, 0.0, 0.0], (300, 1))
    return render_backgrounds(np.random.default_rng(seed), lit, place, (24, 16), "cpu")


def test_backgrounds_are_repeatable_and_vary() -> None:
    first = many()
    assert first.shape == (300, 3, 24, 16)
    assert first.dtype == torch.float32
    assert torch.equal(first, many())
    assert not torch.equal(first, many(1))
    assert first.min() >= 0


def test_a_place_shows_its_colour_and_the_rest_is_no_brighter_than_white_paper() -> None:
    pictures = many()
    place = (pictures[:, 1:] == 0).all((1, 2, 3))  # this one has no green and no blue
    # 40 % of 300; 4 standard deviations of 8.5 are 34.
    assert int(place.sum()) == pytest.approx(120, abs=34)
    assert pictures[place].max() > 1.0
    assert pictures[~place].max() <= 1.0
    contrast = pictures[~place].amax((1, 2, 3)) / pictures[~place].mean((1, 2, 3))
    assert contrast.min() < 1.5  # a wall
    assert contrast.max() > 3.0  # things


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"flip": 1.5}, "flip"),
        ({"flip": float("nan")}, "flip"),
        ({"num_lights": 0}, "num_lights: 0 found, 1 to"),
        ({"size": 4}, "size: 4 found"),
        ({"light": LightSpec(studio=-1.0)}, r"light\.studio: -1 found"),
    ],
)
def test_impossible_augmentations_are_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Augmentation(**values)
