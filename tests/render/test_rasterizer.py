"""The rasteriser: against areas, planes and a sphere in closed form."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sfsnet_dr.render.rasterizer import rasterise
from sfsnet_dr.scene.mesh import sphere_mesh

Array = npt.NDArray[np.float64]


def test_a_triangle_covers_the_centres_inside_it_and_a_plane_stays_one() -> None:
    # Counter-clockwise as seen, with y down: right angle at the top left.
    points = np.array([[2.0, 2.0], [2.0, 12.0], [12.0, 2.0]])
    values = points @ [[1.0, 0.0], [0.0, 1.0]] + 3.0
    picture, seen = rasterise(points, np.zeros(3), np.array([[0, 1, 2]], np.uint32), values, 16)
    row, column = np.indices((16, 16)) + 0.5
    inside = (row > 2) & (column > 2) & (row + column <= 14)
    np.testing.assert_array_equal(seen > 0, inside)
    np.testing.assert_allclose(picture[inside], np.stack([column, row], -1)[inside] + 3.0)
    assert not picture[~inside].any()
    turned = rasterise(points, np.zeros(3), np.array([[0, 2, 1]], np.uint32), values, 16)[1]
    assert not turned.any()  # its back is not seen


def test_the_nearer_of_two_is_seen_whatever_their_order() -> None:
    points = np.array([[-40.0, -40.0], [-40.0, 80.0], [80.0, -40.0]] * 2)
    depth, values = np.array([1.0] * 3 + [2.0] * 3), np.array([[1.0]] * 3 + [[2.0]] * 3)
    for faces in ([[0, 1, 2], [3, 4, 5]], [[3, 4, 5], [0, 1, 2]]):
        picture, seen = rasterise(points, depth, np.array(faces, np.uint32), values, 8)
        assert seen.all()
        np.testing.assert_allclose(picture, 1.0)


def test_a_ball_shows_its_normals() -> None:
    ball = sphere_mesh(radius=1.0, rings=96)
    size, radius = 64, 28.0
    points = size / 2 + radius * ball.vertices[:, :2] * (1, -1)
    picture, seen = rasterise(points, -ball.vertices[:, 2], ball.faces, ball.normals, size)
    row, column = np.indices((size, size)) + 0.5
    x, y = (column - size / 2) / radius, (size / 2 - row) / radius
    inside = x**2 + y**2 < 0.98
    assert seen[inside].all()
    assert not seen[x**2 + y**2 > 1].any()
    exact = np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], -1)[inside]
    found = picture[inside] / np.linalg.norm(picture[inside], axis=-1, keepdims=True)
    off = np.degrees(np.arccos(np.clip((exact * found).sum(-1), -1, 1)))
    assert off.max() < 0.3  # facets of 1.9 degrees; 0.1 found, most at the rim
