"""Catmull-Clark: the published masks on small meshes, and what every linear subdivision must keep."""

from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.scene.faces.subdivision import catmull_clark

CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
CUBE_QUADS = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]], dtype=np.uint32
)


def test_a_cube_by_hand() -> None:
    matrix, quads = catmull_clark(CUBE_QUADS, 8)
    fine = matrix @ CUBE
    assert fine.shape == (8 + 12 + 6, 3)
    assert quads.shape == (24, 4)
    # Corner: (F + 2 R + (3 - 3) P) / 3 with F = 1/3 and R = 2/3 of the corner: 5/9.
    np.testing.assert_allclose(fine[:8], 5 / 9 * CUBE, atol=1e-15)
    # Edge: mean of two corners and two face points: 0.75 of the midpoint's distance in each coordinate.
    np.testing.assert_allclose(
        np.sort(np.abs(fine[8:20]), axis=1), np.tile([0, 0.75, 0.75], (12, 1)), atol=1e-15
    )
    np.testing.assert_allclose(np.sort(np.abs(fine[20:]), axis=1), np.tile([0, 0, 1.0], (6, 1)), atol=1e-15)


def test_rows_sum_to_one_so_that_constants_stay() -> None:
    matrix, _ = catmull_clark(CUBE_QUADS, 8)
    np.testing.assert_allclose(np.asarray(matrix.sum(axis=1)).ravel(), 1.0, atol=1e-15)


def test_orientation_is_kept() -> None:
    matrix, quads = catmull_clark(CUBE_QUADS, 8)
    corners = (matrix @ CUBE)[quads]
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    assert (np.einsum("qc,qc->q", normal, corners.mean(axis=1)) > 0).all()


@pytest.mark.parametrize("row", [0, 2, 4])
def test_a_flat_grid_with_a_border_keeps_linear_functions_inside(row: int) -> None:
    # A regular grid: subdivision reproduces a linear function except at the corners of the border.
    side = 5
    x, y = np.meshgrid(np.arange(side, dtype=float), np.arange(side, dtype=float))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(side * side)], axis=1)
    here = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    quads = np.stack([here, here + 1, here + side + 1, here + side], axis=1).astype(np.uint32)
    fine = catmull_clark(quads, side * side)[0] @ points
    inner = row * side + np.arange(1, side - 1)
    np.testing.assert_allclose(fine[inner], points[inner], atol=1e-14)


def test_the_border_of_a_single_quad_is_a_b_spline() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    matrix, _ = catmull_clark(np.array([[0, 1, 2, 3]], dtype=np.uint32), 4)
    # 3/4 of the corner and 1/8 of each neighbour along the border.
    np.testing.assert_allclose((matrix @ square)[0], [0.125, 0.125, 0], atol=1e-15)
