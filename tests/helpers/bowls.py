"""Hollow surfaces, on which light meets more than one point, with known answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.scene.mesh import Mesh, bowl_mesh, join_meshes, sphere_mesh

Array = NDArray[np.float64]

#: Unit vectors toward directional lights, none of them on an axis.
DIRECTIONS = np.array([[0.6, 0.0, 0.8], [-0.48, 0.6, 0.64], [0.0, -0.28, 0.96]])


def bowl_and_ball(shift: tuple[float, float, float] = (0.25, 0.1, -0.25)) -> Mesh:
    """A bowl with a coloured ball in it, off its middle; gloss from dull to shiny. Nothing is symmetric."""
    ball = sphere_mesh(radius=0.3, albedo=(0.7, 0.35, 0.2), rings=48)
    ball = replace(ball, vertices=ball.vertices + shift)
    hollow = bowl_mesh((0.3, 0.5, 0.6))
    both = join_meshes(hollow, ball)
    mix = np.clip(0.5 + both.vertices[:, 1], 0.0, 1.0)
    return replace(both, roughness_mix=mix)


def turned(mesh: Mesh, matrix: Array) -> Mesh:
    """The mesh after a rotation (3, 3), or after a reflection, which turns the triangles round too."""
    faces = mesh.faces if np.linalg.det(matrix) > 0 else np.ascontiguousarray(mesh.faces[:, ::-1])
    return replace(mesh, vertices=mesh.vertices @ matrix.T, normals=mesh.normals @ matrix.T, faces=faces)
