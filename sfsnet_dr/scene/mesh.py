"""Triangle meshes with per-vertex albedo and region, and shapes given by a formula.

sphere       convex: only the truncation of the light counts
plane        one normal: the simplest closed form
bowl         concave: light meets it many times, and its rim shadows it
two_spheres  one casts a hard shadow on the other
relief       ripples finer than a face's features: shadows, interreflection and filtering everywhere
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError, check_shape

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.uint32]
Colour = tuple[float, float, float]

#: Twice the area, relative to the longest edge squared, below which a triangle counts as degenerate.
_SLIVER = 1e-6


class Region(IntEnum):
    """What a vertex belongs to. The face mask counts ``FACE_REGIONS`` only."""

    SKIN = 0
    LIPS = 1
    BROW = 2
    EYELID = 3
    EAR = 4
    SCALP = 5
    NECK = 6
    EYE_WHITE = 7
    IRIS = 8
    PUPIL = 9
    MOUTH_INSIDE = 10
    TEETH = 11
    TONGUE = 12


#: Label of a pixel that shows no surface.
NO_REGION = 255

#: Regions of face skin: the losses and errors are counted on them.
FACE_REGIONS = (Region.SKIN, Region.LIPS, Region.BROW, Region.EYELID)


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh in the camera frame of ``base.conventions``.

    Attributes:
        vertices: (V, 3) positions, scene units.
        faces: (F, 3) vertex indices, counter-clockwise seen from outside.
        albedo: (V, 3) linear Rec. 709 reflectance in [0, 1].
        regions: (V,) values of ``Region``.
        normals: (V, 3) unit shading normals.
        roughness_mix: (V,) share of the shinier of the two glossy lobes, in [0, 1]; None is 0 everywhere.
    """

    vertices: Array
    faces: Indices
    albedo: Array
    regions: npt.NDArray[np.uint8]
    normals: Array
    roughness_mix: Array | None = None

    def __post_init__(self) -> None:
        count = check_shape("Mesh.vertices", self.vertices, "V 3")["V"]
        if self.roughness_mix is not None:
            check_shape("Mesh.roughness_mix", self.roughness_mix, "V", V=count)
        check_shape("Mesh.faces", self.faces, "F 3")
        for name in ("albedo", "normals"):
            check_shape(f"Mesh.{name}", getattr(self, name), "V 3", V=count)
        check_shape("Mesh.regions", self.regions, "V", V=count)
        if self.faces.size and int(self.faces.max()) >= count:
            raise InputError(f"Mesh.faces: index {int(self.faces.max())} found, below {count} allowed")
        if not np.isfinite(self.vertices).all():
            raise InputError("Mesh.vertices: NaN or inf found, finite positions allowed")


def vertex_normals(vertices: Array, faces: Indices) -> Array:
    """Unit vertex normals: face normals weighted by the corner's angle (Thuermer and Wuethrich 1998).

    Args:
        vertices: (V, 3).
        faces: (F, 3), counter-clockwise seen from outside.

    Returns:
        (V, 3) unit vectors; a vertex of no face, or of degenerate ones only, gets (0, 0, 1).
    """
    corners = vertices[faces]
    edges = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(edges, axis=2, keepdims=True)
    area = np.cross(edges[:, 0], edges[:, 1])
    twice = np.linalg.norm(area, axis=1, keepdims=True)
    # A sliver's direction is rounding error: it has no say.
    sound = twice > _SLIVER * lengths.max(axis=1) ** 2
    face_normals = np.where(sound, area / np.maximum(twice, 1e-300), 0.0)
    edges = edges / np.maximum(lengths, 1e-300)
    cosines = -np.einsum("fkc,fkc->fk", edges, np.roll(edges, 1, axis=1))
    weights = np.arccos(np.clip(cosines, -1.0, 1.0))[..., None] * face_normals[:, None]
    flat = faces.ravel()
    summed = np.stack(
        [np.bincount(flat, weights[..., axis].ravel(), len(vertices)) for axis in range(3)], axis=1
    )
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    return np.where(length > 1e-20, summed / np.maximum(length, 1e-30), (0.0, 0.0, 1.0))


def sphere_mesh(radius: float = 0.9, albedo: Colour = (0.5, 0.5, 0.5), rings: int = 96) -> Mesh:
    """A latitude-longitude sphere about the origin with exact normals.

    With 96 rings the facets lie at most 0.03 % of the radius inside the sphere.
    """
    polar = np.linspace(0.0, np.pi, rings + 1)
    azimuth = np.linspace(0.0, 2 * np.pi, 2 * rings, endpoint=False)
    theta, phi = np.meshgrid(polar, azimuth, indexing="ij")
    unit = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], axis=-1)
    ring, step = np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij")
    here = ring * 2 * rings + step
    right = ring * 2 * rings + (step + 1) % (2 * rings)
    quads = np.stack([here, here + 2 * rings, right + 2 * rings, right], axis=-1).reshape(-1, 4)
    faces = triangulate(quads.astype(np.uint32))
    normals = unit.reshape(-1, 3)
    return _uniform(radius * normals, faces, normals, albedo)


def plane_mesh(size: float = 4.0, albedo: Colour = (0.5, 0.5, 0.5)) -> Mesh:
    """A square in z = 0 that faces the viewer. ``size`` is its edge in scene units (the view is 2 wide)."""
    half = size / 2
    vertices = np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
    return _uniform(vertices, faces, np.tile([0.0, 0.0, 1.0], (4, 1)), albedo)


def triangulate(quads: Indices) -> Indices:
    """Split (Q, 4) quads along their first diagonal into (2 Q, 3) triangles."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.uint32)


def _uniform(vertices: Array, faces: Indices, normals: Array, albedo: Colour) -> Mesh:
    count = len(vertices)
    return Mesh(
        vertices=vertices,
        faces=faces,
        albedo=np.tile(np.asarray(albedo, dtype=np.float64), (count, 1)),
        regions=np.full(count, Region.SKIN, dtype=np.uint8),
        normals=normals,
    )


_RIPPLE_HEIGHT, _RIPPLE_LENGTH = 0.05, 0.4  # scene units: slopes up to 38 degrees


def bowl_mesh(albedo: Colour = (0.5, 0.5, 0.5), rings: int = 64) -> Mesh:
    """The inside of the rear half of a sphere about the origin, open to the viewer; rings / 4 is whole."""
    ball = sphere_mesh(albedo=albedo, rings=rings)
    behind = ball.vertices[ball.faces][..., 2].max(axis=1) < 1e-9
    faces = np.ascontiguousarray(ball.faces[behind][:, ::-1])
    return replace(ball, faces=faces, normals=-ball.normals)


def two_spheres_mesh(albedo: Colour = (0.5, 0.5, 0.5), rings: int = 96) -> Mesh:
    """A large ball, and a small one toward the upper right and the viewer, which shadows it from there."""
    large = move_mesh(sphere_mesh(0.62, albedo, rings), (-0.22, -0.22, 0.0))
    small = move_mesh(sphere_mesh(0.26, albedo, rings), (0.3, 0.3, 0.74))
    return join_meshes(large, small)


def relief_mesh(albedo: Colour = (0.5, 0.5, 0.5), cells: int = 256) -> Mesh:
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


def move_mesh(mesh: Mesh, shift: tuple[float, float, float]) -> Mesh:
    """The mesh elsewhere."""
    return replace(mesh, vertices=mesh.vertices + shift)


def join_meshes(*meshes: Mesh) -> Mesh:
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
    "sphere": lambda albedo: sphere_mesh(albedo=albedo),
    "plane": lambda albedo: plane_mesh(albedo=albedo),
    "bowl": lambda albedo: bowl_mesh(albedo, rings=96),
    "two_spheres": two_spheres_mesh,
    "relief": relief_mesh,
}
