from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sfsnet_dr.scene.lights.equirect import (
    MAP_SIZE,
    pixel_directions,
    pixel_solid_angles,
    resample_map,
    sample_map,
    turn_map,
)
from sfsnet_dr.scene.lights.light import rotation_about
from sfsnet_dr.sh.projection import equirect_directions, equirect_solid_angles, project_equirect
from sfsnet_dr.sh.rotation import rotate

UP = np.array([0.0, 1.0, 0.0])
ASLANT = np.array([0.48, 0.6, 0.64])


def smooth(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Three positive colours that differ in every direction."""
    x, y, z = np.moveaxis(directions, -1, 0)
    return np.stack([1.5 + x, 1.2 + 0.5 * y * z, np.exp(x - y + 0.5 * z)], axis=-1)


def test_lookup_is_the_convention_of_the_projection() -> None:
    image = smooth(equirect_directions(*MAP_SIZE))
    random = np.random.default_rng(0).normal(size=(500, 3))
    random /= np.linalg.norm(random, axis=1, keepdims=True)
    # Bilinear error: step^2 / 8 times the largest second derivative, 0.05^2 / 8 * 1.5^2 e^1.5 = 3.2e-3.
    np.testing.assert_allclose(sample_map(image, random), smooth(random), atol=3.2e-3)
    # Texel centres give the texels; acos and atan2 lose half the digits near the poles.
    np.testing.assert_allclose(sample_map(image, equirect_directions(*MAP_SIZE)), image, atol=1e-6)


@pytest.mark.parametrize("columns", [1, 37, 127])
def test_turning_by_whole_columns_is_rolling(columns: int) -> None:
    image = np.random.default_rng(1).uniform(size=(*MAP_SIZE, 3))
    turned = turn_map(image, rotation_about(UP, -360.0 * columns / MAP_SIZE[1]))
    # Columns to the right are toward -x, so a negative turn about y moves the map right. The poles' rows are
    # one point each, which a map of random texels does not respect.
    np.testing.assert_allclose(turned[1:-1], np.roll(image, columns, axis=1)[1:-1], atol=1e-6)


def test_turning_the_map_turns_its_coefficients() -> None:
    image = smooth(equirect_directions(*MAP_SIZE))
    turn = rotation_about(ASLANT, 50.0)
    expected = rotate(project_equirect(image, 4), turn).values
    found = project_equirect(turn_map(image, turn), 4).values
    # The blur of one more bilinear interpolation: 3e-4 of the largest coefficient seen, times 3.
    np.testing.assert_allclose(found, expected, atol=9e-4 * np.abs(expected).max())
    wrong = project_equirect(turn_map(image, turn.T), 4).values
    assert np.abs(wrong - expected).max() > 0.1


@pytest.mark.parametrize("size", [(16, 32), (128, 256), (250, 500)])
def test_resampling_keeps_the_light(size: tuple[int, int]) -> None:
    directions = pixel_directions(*size)
    picture = smooth(directions)
    picture[size[0] // 3, 5] += 1000  # a texel that point sampling would miss
    image = resample_map(picture)
    before = np.einsum("hw,hwc->c", pixel_solid_angles(*size), picture)
    after = np.einsum("hw,hwc->c", equirect_solid_angles(*MAP_SIZE), image)
    # Midpoints in the row integrals: 2e-6 seen for 128 rows, 1e-4 for 16, times 3.
    np.testing.assert_allclose(after, before, rtol=3e-4)
    brightest = np.unravel_index(image[..., 0].argmax(), MAP_SIZE)
    apart = equirect_directions(*MAP_SIZE)[brightest] @ directions[size[0] // 3, 5]
    # Half a texel of the map (2.8 degrees) and half a pixel of the picture.
    assert np.degrees(np.arccos(apart)) < 0.75 * (2.9 + 180 / size[0])


def test_solid_angles_of_a_picture_fill_the_sphere() -> None:
    np.testing.assert_allclose(pixel_solid_angles(40, 80).sum(), 4 * np.pi, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(pixel_directions(40, 80), axis=-1), 1.0, atol=1e-12)
