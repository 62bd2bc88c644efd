"""Surfaces given by a formula, each of which brings out one cause of error of a renderer.

sphere       convex: only the truncation of the light counts
plane        one normal: the simplest closed form
bowl         concave: light meets it many times, and its rim shadows it
two_spheres  one casts a hard shadow on the other
relief       ripples finer than a face's features: shadows, interreflection and filtering everywhere
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.mesh import Colour, Mesh, Region, plane, sphere, triangulate

Array = npt.NDArray[np.float64]

_RIPPLE_HEIGHT, _RIPPLE_LENGTH = 0.05, 0.4  # scene units: slopes up to 38 degrees


def bowl(albedo: Colour = (0.5, 0.5, 0.5), rings: int = 64) -> Mesh:
    """The inside of the rear half of a sphere about the origin, open to the viewer; rings / 4 is whole."""
    ball = sphere(albedo=albedo, rings=rings)
    behind = ball.vertices[ball.faces][..., 2].max(axis=1) < 1e-9
    faces = np.ascontiguousarray(ball.faces[behind][:, ::-1])
    return replace(ball, faces=faces, normals=-ball.normals)


def two_spheres(albedo: Colour = (0.5, 0.5, 0.5), rings: int = 96) -> Mesh:
    """A large ball, and a small one toward the upper right and the viewer, which shadows it from there."""
    large = moved(sphere(0.62, albedo, rings), (-0.22, -0.22, 0.0))
    small = moved(sphere(0.26, albedo, rings), (0.3, 0.3, 0.74))
    return joined(large, small)


def relief(albedo: Colour = (0.5, 0.5, 0.5), cells: int = 256) -> Mesh:
    """A wall with rings of ripples about the middle of the view, larger than the view."""
    axis = np.linspace(-1.3, 1.3, cells + 1)
    x, y = (values.ravel() for values in np.meshgrid(axis, axis))
    radius, wave = np.hypot(x, y), 2 * np.pi / _RIPPLE_LENGTH
    slope = -_RIPPLE_HEIGHT * wave * np.sin(wave * radius) / np.maximum(radius, 1e-12)
    normals = np.stack([-slope * x, -slope * y, np.ones_like(x)], axis=-1)
    row, column = np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij")
    corner = (row * (cells + 1) + column).ravel()
    quads = np.stack([corner, corner + 1, corner + cells + 2, corner + cells + 1], axis=-1)
    return Mesh(
        vertices=np.stack([x, y, _RIPPLE_HEIGHT * np.cos(wave * radius)], axis=-1),
        faces=triangulate(quads.astype(np.uint32)),
        albedo=np.tile(np.asarray(albedo, dtype=np.float64), (len(x), 1)),
        regions=np.full(len(x), Region.SKIN, dtype=np.uint8),
        normals=normals / np.linalg.norm(normals, axis=-1, keepdims=True),
    )


def moved(mesh: Mesh, shift: tuple[float, float, float]) -> Mesh:
    """The mesh elsewhere."""
    return replace(mesh, vertices=mesh.vertices + shift)


def joined(*meshes: Mesh) -> Mesh:
    """Several surfaces as one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    mixes = [m.roughness_mix if m.roughness_mix is not None else np.zeros(len(m.vertices)) for m in meshes]
    faces = [mesh.faces + int(k) for mesh, k in zip(meshes, starts, strict=True)]
    return Mesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        faces=np.concatenate(faces).astype(np.uint32),
        albedo=np.concatenate([mesh.albedo for mesh in meshes]),
        regions=np.concatenate([mesh.regions for mesh in meshes]),
        normals=np.concatenate([mesh.normals for mesh in meshes]),
        roughness_mix=np.concatenate(mixes),
    )


#: How each is made of its albedo, by the name that scenes give.
SHAPES: Final[dict[str, Callable[[Colour], Mesh]]] = {
    "sphere": lambda albedo: sphere(albedo=albedo),
    "plane": lambda albedo: plane(albedo=albedo),
    "bowl": lambda albedo: bowl(albedo, rings=96),
    "two_spheres": two_spheres,
    "relief": relief,
}
