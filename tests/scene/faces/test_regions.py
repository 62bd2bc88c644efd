"""Distances to curves against shapes whose distances are known."""

from __future__ import annotations

import numpy as np

from sfsnet_dr.scene.faces.regions import distance_to, inside_outline, signed_distance

SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])


def test_distance_and_place_on_a_path() -> None:
    path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    away, along = distance_to(np.array([[0.5, 0.3], [1.4, 0.5], [1.0, 3.0], [-3.0, -4.0]]), path)
    np.testing.assert_allclose(away, [0.3, 0.4, 2.0, 5.0])
    np.testing.assert_allclose(along, [0.25, 0.75, 1.0, 0.0])


def test_inside_a_square_and_a_notch() -> None:
    points = np.array([[1.0, 1.0], [3.0, 1.0], [-0.1, 0.5], [1.9, 1.9]])
    np.testing.assert_array_equal(inside_outline(points, SQUARE), [True, False, False, True])
    notched = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [1.0, 0.5], [0.0, 2.0]])
    np.testing.assert_array_equal(inside_outline(np.array([[1.0, 1.0], [1.0, 0.3]]), notched), [False, True])


def test_signed_distance_of_a_circle() -> None:
    angle = np.linspace(0.0, 2 * np.pi, 400, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.random.default_rng(0).uniform(-2.0, 2.0, (200, 2))
    # A polygon of 400 corners lies at most 1 - cos(pi / 400) = 3.1e-5 inside its circle.
    np.testing.assert_allclose(signed_distance(points, circle), 1.0 - np.hypot(*points.T), atol=4e-5)
