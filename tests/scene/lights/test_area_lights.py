from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.scene.lights.area_lights import Panel, studio_environment
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import direction_from_angles, rotation_about
from sfsnet_dr.sh.projection import equirect_directions, equirect_solid_angles

WARM = np.array([3.0, 2.0, 1.0])
BLACK = np.zeros(3)


@pytest.mark.parametrize("round_", [True, False])
def test_a_panel_covers_its_solid_angle(round_: bool) -> None:
    panel = Panel(direction_from_angles(30, 20), (20.0, 12.0), 25.0, 3.0, WARM, round_)
    image = studio_environment((panel,), BLACK, BLACK)
    power = np.einsum("hw,hwc->c", equirect_solid_angles(*MAP_SIZE), image)
    half = np.radians([20.0, 12.0])
    pyramid = 4 * np.arcsin(np.sin(half[0]) * np.sin(half[1]))  # between four great circles
    expected = np.pi * half[0] * half[1] if round_ else pyramid
    # Soft edges, and for the ellipse the flat formula: 1.5 % seen, times 2.
    np.testing.assert_allclose(power, WARM * expected, rtol=0.03)


def test_inside_edge_and_outside() -> None:
    direction = direction_from_angles(0, 0)
    panel = Panel(direction, (20.0, 10.0), 0.0, 4.0, WARM, round=False)
    np.testing.assert_allclose(panel.at(direction), WARM)
    np.testing.assert_allclose(panel.at(direction_from_angles(0, 10)), WARM / 2)  # the middle of the fade
    np.testing.assert_allclose(panel.at(direction_from_angles(15, 0)), WARM)
    for away in (direction_from_angles(0, 14), direction_from_angles(25, 0), direction_from_angles(180, 0)):
        np.testing.assert_array_equal(panel.at(away), BLACK)
    # Turned by 90 degrees, width and height change places.
    upright = Panel(direction, (20.0, 10.0), 90.0, 4.0, WARM, round=False)
    np.testing.assert_allclose(upright.at(direction_from_angles(0, 15)), WARM)
    np.testing.assert_array_equal(upright.at(direction_from_angles(15, 0)), BLACK)


def test_a_panel_overhead_has_axes() -> None:
    panel = Panel(direction_from_angles(0, 90), (20.0, 20.0), 0.0, 4.0, WARM, round=True)
    away = rotation_about(np.array([0.6, 0.0, 0.8]), 12.0) @ direction_from_angles(0, 90)
    np.testing.assert_allclose(panel.at(away), WARM)


def test_walls_and_floor() -> None:
    image = studio_environment((), np.full(3, 0.2), np.full(3, 0.05))
    height = equirect_directions(*MAP_SIZE)[..., 1]
    np.testing.assert_allclose(image[height >= 0], 0.2)
    np.testing.assert_allclose(image[-1], 0.05)
