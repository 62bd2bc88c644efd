"""Directions that cover the sphere evenly: corners of an icosahedron whose faces are divided."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, SphericalVoronoi

from sfsnet_dr.core.errors import InputError

Array = NDArray[np.float64]

#: Most divisions: 40,962 directions.
MAX_LEVEL: Final = 6

_GOLDEN = (1 + 5**0.5) / 2


@cache
def icosphere(level: int) -> Array:
    """Unit vectors (10 * 4^level + 2, 3), read-only; level 3 has 642, about 8 degrees apart.

    Raises:
        InputError: for a level outside 0 to ``MAX_LEVEL``.
    """
    if not 0 <= level <= MAX_LEVEL:
        raise InputError(f"level: {level} found, 0 to {MAX_LEVEL} allowed")
    corners = np.array([(0.0, a, b * _GOLDEN) for a in (-1, 1) for b in (-1, 1)])
    points = np.concatenate([np.roll(corners, turn, axis=1) for turn in range(3)])
    for _ in range(level):
        faces = ConvexHull(points).simplices
        edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
        points = np.concatenate([points, points[edges].sum(axis=1)])
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points.setflags(write=False)
    return points


@cache
def icosphere_solid_angles(level: int) -> Array:
    """Solid angles (N,) of the regions nearest to each direction; they sum to 4 pi."""
    areas: Array = np.asarray(SphericalVoronoi(icosphere(level)).calculate_areas())
    areas.setflags(write=False)
    return areas
