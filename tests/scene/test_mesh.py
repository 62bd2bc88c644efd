"""Meshes: closed forms of the sphere and plane, normals against them, and what a mesh refuses."""

from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.mesh import Mesh, plane_mesh, sphere_mesh, vertex_normals


def test_sphere_vertices_lie_on_it_and_its_normals_are_exact() -> None:
    ball = sphere_mesh(radius=0.9)
    np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), 0.9, rtol=1e-14)
    np.testing.assert_allclose(ball.vertices, 0.9 * ball.normals, atol=1e-14)


def test_sphere_triangles_face_outward() -> None:
    ball = sphere_mesh(rings=16)
    corners = ball.vertices[ball.faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = np.einsum("fc,fc->f", area, corners.mean(axis=1))
    flat = np.linalg.norm(area, axis=1) < 1e-12  # the triangles that close the poles have no area
    assert flat.sum() == 2 * 32
    assert (outward[~flat] > 0).all()


def test_sphere_area_and_volume_converge_to_the_closed_forms() -> None:
    # A latitude-longitude mesh of n rings is second order: its errors fall by 4 when n doubles.
    def errors(rings: int) -> tuple[float, float]:
        ball = sphere_mesh(radius=1.0, rings=rings)
        a, b, c = np.moveaxis(ball.vertices[ball.faces], 1, 0)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
        volume = np.einsum("fc,fc->f", a, np.cross(b, c)).sum() / 6
        return 4 * np.pi - area, 4 * np.pi / 3 - volume

    coarse, fine = errors(24), errors(48)
    for large, small in zip(coarse, fine, strict=True):
        assert large / small == pytest.approx(4.0, rel=0.02)


def test_vertex_normals_of_a_sphere_agree_with_the_exact_ones() -> None:
    ball = sphere_mesh(rings=48)
    found = vertex_normals(ball.vertices, ball.faces)
    angle = np.degrees(np.arccos(np.clip(np.einsum("vc,vc->v", found, ball.normals), -1, 1)))
    polar = np.degrees(np.arccos(np.clip(np.abs(ball.normals[:, 1]), 0, 1)))
    # Second order in the 3.75 degrees between rings; measured worst 0.039 but for the poles, times 2.
    assert angle[polar > 0.1].max() < 0.08


def test_vertex_normals_turn_with_the_mesh() -> None:
    ball = sphere_mesh(rings=12)
    squeezed = ball.vertices * (1.0, 0.6, 1.3)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    straight = vertex_normals(squeezed, ball.faces)
    np.testing.assert_allclose(vertex_normals(squeezed @ turn.T, ball.faces), straight @ turn.T, atol=1e-12)


def test_plane_faces_the_viewer() -> None:
    square = plane_mesh()
    np.testing.assert_array_equal(square.normals, np.tile([0.0, 0.0, 1.0], (4, 1)))
    np.testing.assert_allclose(vertex_normals(square.vertices, square.faces), square.normals, atol=1e-15)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"albedo": np.zeros((3, 3))}, "Mesh.albedo: shape (3, 3) found"),
        ({"faces": np.array([[0, 1, 4]], dtype=np.uint32)}, "index 4 found, below 4 allowed"),
        ({"vertices": np.full((4, 3), np.nan)}, "Mesh.vertices: NaN or inf found"),
    ],
)
def test_a_wrong_mesh_is_refused(change: dict[str, np.ndarray], words: str) -> None:
    square = plane_mesh()
    with pytest.raises(InputError, match=words.replace("(", r"\(").replace(")", r"\)")):
        Mesh(**(square.__dict__ | change))
