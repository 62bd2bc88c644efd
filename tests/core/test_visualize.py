"""Pictures for people: the codes they use, and the sheet that shows them side by side."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.visualize import Pixels, on_white, png_bytes, show_linear, show_normals
from sfsnet_dr.inference.sheet import SheetStyle, draw_sheet


def decoded(png: bytes) -> Pixels:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def test_linear_values_are_encoded_by_the_srgb_standard() -> None:
    # IEC 61966-2-1: 0.0031308 and below is 12.92 times the value, above 1.055 x^(1/2.4) - 0.055.
    linear = np.array([0.0, 0.002, 0.18, 1.0, 1.7, -0.3])
    expected = [0, round(255 * 12.92 * 0.002), round(255 * (1.055 * 0.18 ** (1 / 2.4) - 0.055)), 255, 255, 0]
    shown = show_linear(np.repeat(linear[None, :, None], 3, axis=2))
    assert shown[0, :, 1].tolist() == expected


def test_normals_have_the_usual_colours() -> None:
    axes = np.array([[[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0]]])
    assert show_normals(axes)[0].tolist() == [
        [255, 128, 128],
        [128, 255, 128],
        [128, 128, 255],
        [0, 128, 128],
    ]


def test_mask_fades_to_white() -> None:
    picture = np.full((1, 3, 3), 100, np.uint8)
    faded = on_white(picture, np.array([[1.0, 0.5, 0.0]]))
    assert faded[0, :, 0].tolist() == [100, 178, 255]


def test_png_bytes_keep_every_pixel_and_repeat() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    assert (decoded(png_bytes(picture)) == picture).all()
    assert png_bytes(picture) == png_bytes(picture.copy())


def test_the_sheet_shows_the_pixels_unchanged_in_reading_order() -> None:
    rng = np.random.default_rng(1)
    pictures = [(f"picture {k}", rng.integers(0, 256, (8, 8, 3), dtype=np.uint8)) for k in range(5)]
    style = SheetStyle(cell=64, gap=10, margin=12, label=30, title=40)
    drawn = decoded(draw_sheet(pictures, title="five", columns=3, style=style))
    assert drawn.shape == (12 + 40 + 2 * (64 + 30 + 10) - 10 + 12, 2 * 12 + 3 * 74 - 10, 3)
    for index, (_, picture) in enumerate(pictures):
        x, y = 12 + (index % 3) * 74, 52 + (index // 3) * 104
        assert (drawn[y + 4 : y + 64 : 8, x + 4 : x + 64 : 8] == picture).all(), index
    assert (drawn[-90:, -60:] == 255).all(), "the sixth place must stay empty"


def test_other_shapes_are_named() -> None:
    with pytest.raises(InputError, match="image: shape"):
        show_linear(np.zeros((4, 4)))
    with pytest.raises(InputError, match="mask: shape"):
        on_white(np.zeros((4, 4, 3), np.uint8), np.ones((4, 5)))
