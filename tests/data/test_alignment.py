"""The canonical frame of photographs, against images whose value is known at every place."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sfsnet_dr.core.conventions import CHIN_ROW, EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.alignment import canonical_coverage, face_ellipse_mask, read_eyes, side_file, to_canonical


def ramp(height: int, width: int) -> NDArray[np.float64]:
    """Channels x, y and 1 at each pixel centre: linear, so every correct resampling keeps them exactly."""
    y, x = np.mgrid[:height, :width] + 0.5
    return np.stack([x, y, np.ones_like(x)], axis=-1)


@pytest.mark.parametrize(
    ("scale", "degrees"), [(1.0, 0.0), (0.5, 10.0), (1.7, -20.0), (3.0, 30.0), (9.0, -5.0)]
)
def test_a_point_beside_the_eyes_comes_from_where_geometry_says(scale: float, degrees: float) -> None:
    turn = np.array(
        [
            [math.cos(math.radians(degrees)), -math.sin(math.radians(degrees))],
            [math.sin(math.radians(degrees)), math.cos(math.radians(degrees))],
        ]
    )
    middle = np.array([120.0, 110.0]) * scale
    half = scale * turn @ np.array([19.0, 0.0])
    eyes = (tuple(middle - half), tuple(middle + half))
    size = math.ceil(240 * scale)
    canonical = to_canonical(ramp(size, size), eyes)

    for i, j in ((48, 64), (20, 30), (100, 70), (64, 100)):
        down = np.array([j + 0.5 - 64, i + 0.5 - 48.0])
        expected = middle + scale * turn @ down
        # Blocks (only above 8 pixels a step) and float32 keep a ramp exactly; 1e-4 pixel is rounding at 1000.
        np.testing.assert_allclose(canonical[i, j, :2], expected, atol=2e-4 * max(1, scale))
    np.testing.assert_allclose(canonical[..., 2], 1, atol=1e-6)


def test_the_identity_keeps_a_canonical_picture() -> None:
    image = np.random.default_rng(0).uniform(size=(128, 128, 3)).astype(np.float32)
    np.testing.assert_allclose(
        to_canonical(image, (EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT)), image, atol=1e-6
    )  # float32 rounding


@pytest.mark.parametrize("scale", [4, 12])
def test_reduction_is_the_mean_over_the_pixels_square(scale: int) -> None:
    fine = np.random.default_rng(1).uniform(size=(128 * scale, 128 * scale, 3))
    (xl, yl), (xr, yr) = EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT
    eyes = ((xl * scale, yl * scale), (xr * scale, yr * scale))
    expected = fine.reshape(128, scale, 128, scale, 3).mean((1, 3))
    # Samples fall on pixel centres at scale 4 and on block centres at 12, so the mean is exact.
    np.testing.assert_allclose(to_canonical(fine, eyes), expected, atol=1e-6)


def test_inside_is_the_covered_share() -> None:
    share = canonical_coverage(64, 128, (EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT))
    assert (share[:63] == 1).all()
    assert (share[65:] == 0).all()
    assert share[:, 0].sum() == pytest.approx(64, abs=1)


def test_the_default_mask_is_a_face_sized_ellipse() -> None:
    mask = face_ellipse_mask()
    # area of an ellipse, pi a b; the pixel grid of 1/8 keeps it to one part in a thousand
    assert mask.sum() == pytest.approx(math.pi * 1.1 * 38 * (CHIN_ROW - 18) / 2, rel=1e-3)
    np.testing.assert_array_equal(mask, mask[:, ::-1])
    rows = np.flatnonzero(mask.any(1))
    assert (rows[0], rows[-1]) == (18, CHIN_ROW - 1)
    assert mask[48, 45] == mask[48, 83] == 1


@pytest.mark.parametrize(
    ("eyes", "words"),
    [
        (((10.0, 10.0), (90.0, 200.0)), "100 x 80 picture"),
        (((60.0, 10.0), (20.0, 10.0)), "image's left first"),
        (((60.0, 10.0), (63.0, 10.0)), "3.0 pixels apart"),
        (((float("nan"), 10.0), (63.0, 10.0)), "a point in"),
    ],
)
def test_impossible_eyes_are_refused(eyes: tuple[tuple[float, float], ...], words: str) -> None:
    with pytest.raises(InputError, match=words):
        to_canonical(ramp(80, 100), eyes)  # type: ignore[arg-type]


def test_a_grey_picture_is_refused() -> None:
    with pytest.raises(InputError, match="image"):
        to_canonical(np.ones((80, 100)), ((10, 10), (60, 10)))


def test_a_side_file_gives_the_eyes(tmp_path: Path) -> None:
    path = side_file(tmp_path / "face.jpg")
    path.write_text("eye_image_left = [10, 20.5]\neye_image_right = [60, 21]\n")
    assert read_eyes(path) == ((10.0, 20.5), (60.0, 21.0))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("eye_left = [1, 2]", "unknown key 'eye_left'; did you mean"),
        ("eye_image_left = [1, 2]", "key 'eye_image_right' is missing"),
        ("eye_image_left = [1]\neye_image_right = [1, 2]", "eye_image_left: 1 values found, 2 are needed"),
        ("eye_image_left = [true, 2]\neye_image_right = [1, 2]", "eye_image_left: True found"),
        ("eye_image_left = ", "TOML"),
    ],
)
def test_damaged_side_files_are_refused(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "face.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_eyes(path)
    with pytest.raises(InputError, match="no such file"):
        read_eyes(tmp_path / "other.toml")
