"""Distances to curves in the plane, with which regions are drawn on a face."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def distance_to(points: Array, path: Array) -> tuple[Array, Array]:
    """Distance to a path and the place on it.

    Args:
        points: (N, 2).
        path: (K, 2) corners.

    Returns:
        (N,) distances, and (N,) positions of the nearest points, 0 at the first corner, 1 at the last.
    """
    nearest, position = np.full(len(points), np.inf), np.zeros(len(points))
    for k, (start, end) in enumerate(pairwise(path)):
        edge = end - start
        along = np.clip((points - start) @ edge / max(float(edge @ edge), 1e-30), 0.0, 1.0)
        distance = np.linalg.norm(points - start - along[:, None] * edge, axis=1)
        closer = distance < nearest
        nearest = np.where(closer, distance, nearest)
        position = np.where(closer, (k + along) / (len(path) - 1), position)
    return nearest, position


def inside(points: Array, outline: Array) -> npt.NDArray[np.bool_]:
    """Whether (N, 2) points lie inside a closed (K, 2) polygon (even-odd rule)."""
    within = np.zeros(len(points), dtype=bool)
    x, y = points.T
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if y0 != y1:
            crosses = (y0 > y) != (y1 > y)
            within ^= crosses & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return within


def signed_distance(points: Array, outline: Array) -> Array:
    """(N,) distance to a closed (K, 2) polygon, positive inside."""
    away, _ = distance_to(points, np.vstack([outline, outline[:1]]))
    return np.where(inside(points, outline), away, -away)
