"""Small scenes with known answers for the tests of the renderers."""

from __future__ import annotations

import numpy as np

from sfsnet_dr.scene.mesh import Mesh, Region, plane_mesh


def plane_with_shade(offset: float, albedo: float = 0.5) -> Mesh:
    """A plane that fills the view, and a square of edge 1 at height 0.8 above it, ``offset`` to the right."""
    ground = plane_mesh()
    roof = plane_mesh(size=1.0)
    vertices = np.concatenate([ground.vertices, roof.vertices + np.array([offset, 0.0, 0.8])])
    count = len(vertices)
    return Mesh(
        vertices=vertices,
        faces=np.concatenate([ground.faces, roof.faces + 4]).astype(np.uint32),
        albedo=np.full((count, 3), albedo),
        regions=np.full(count, Region.SKIN, dtype=np.uint8),
        normals=np.tile([0.0, 0.0, 1.0], (count, 1)),
    )
