"""Catmull-Clark subdivision of a quad mesh as one sparse matrix, so that moving a head costs one product."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import sparse

Quads = npt.NDArray[np.uint32]


def catmull_clark(quads: Quads, count: int) -> tuple[sparse.csr_matrix, Quads]:
    """One level of subdivision (Catmull and Clark 1978; boundary rules as cubic B-splines).

    Args:
        quads: (Q, 4) vertex indices, consistently oriented.
        count: number of vertices V; each must belong to a face.

    Returns:
        The matrix S (V', V) with fine = S @ coarse for any per-vertex quantity, and the (4 Q, 4) fine quads.
        Fine vertices come in the order: old vertices, edges, faces.
    """
    edges, edge_of = _edges(quads)
    faces_of_edge = np.bincount(edge_of.ravel(), minlength=len(edges))
    face_points = _average(np.repeat(np.arange(len(quads)), 4), quads.ravel(), len(quads), count)
    edge_points = _edge_points(edges, edge_of, faces_of_edge, face_points, count)
    vertex_points = _vertex_points(quads, edges, faces_of_edge, face_points, count)
    matrix = sparse.vstack([vertex_points, edge_points, face_points]).tocsr()
    edge_index = (count + edge_of).astype(np.uint32)
    centre = np.repeat((count + len(edges) + np.arange(len(quads)))[:, None], 4, axis=1).astype(np.uint32)
    fine = np.stack([quads, edge_index, centre, np.roll(edge_index, 1, axis=1)], axis=2)
    return matrix, fine.reshape(-1, 4)


def _edges(quads: Quads) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """(E, 2) unique edges and, for each quad, the (Q, 4) edges from corner k to corner k + 1."""
    pairs = np.stack([quads, np.roll(quads, -1, axis=1)], axis=2).reshape(-1, 2).astype(np.int64)
    edges, inverse = np.unique(np.sort(pairs, axis=1), axis=0, return_inverse=True)
    return edges, inverse.reshape(quads.shape)


def _average(
    rows: npt.NDArray[np.integer], columns: npt.NDArray[np.integer], height: int, width: int
) -> sparse.csr_matrix:
    """A matrix whose rows average the listed columns."""
    ones = sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(height, width))
    counts = np.maximum(np.asarray(ones.sum(axis=1)).ravel(), 1.0)
    return sparse.diags(1.0 / counts) @ ones


def _edge_points(
    edges: npt.NDArray[np.int64],
    edge_of: npt.NDArray[np.int64],
    faces_of_edge: npt.NDArray[np.int64],
    face_points: sparse.csr_matrix,
    count: int,
) -> sparse.csr_matrix:
    """Inside: mean of the two ends and the two face points. Boundary: midpoint."""
    midpoints = _average(np.repeat(np.arange(len(edges)), 2), edges.ravel(), len(edges), count)
    face_rows = np.repeat(np.arange(len(edge_of)), 4)
    beside = _average(edge_of.ravel(), face_rows, len(edges), len(edge_of)) @ face_points
    inside = 0.5 * (faces_of_edge == 2)
    return sparse.diags(1.0 - inside) @ midpoints + sparse.diags(inside) @ beside


def _vertex_points(
    quads: Quads,
    edges: npt.NDArray[np.int64],
    faces_of_edge: npt.NDArray[np.int64],
    face_points: sparse.csr_matrix,
    count: int,
) -> sparse.csr_matrix:
    """Inside: (F + 2 R + (n - 3) P) / n. Boundary: 3/4 P + 1/4 mean of the two boundary neighbours."""
    identity = sparse.identity(count, format="csr")
    face_rows = np.repeat(np.arange(len(quads)), 4)
    around = _average(quads.ravel(), face_rows, count, len(quads)) @ face_points
    valence = np.bincount(edges.ravel(), minlength=count).astype(np.float64)
    both = np.concatenate([edges, edges[:, ::-1]])
    neighbours = _average(both[:, 0], both[:, 1], count, count)
    ring = 0.5 * (identity + neighbours)  # mean of the edge midpoints around a vertex
    inner = (
        sparse.diags(1.0 / valence) @ around
        + sparse.diags(2.0 / valence) @ ring
        + sparse.diags((valence - 3.0) / valence) @ identity
    )
    rim = edges[faces_of_edge == 1]
    both_rim = np.concatenate([rim, rim[:, ::-1]])
    on_rim = np.bincount(rim.ravel(), minlength=count) > 0
    outer = 0.75 * identity + 0.25 * _average(both_rim[:, 0], both_rim[:, 1], count, count)
    return (
        sparse.diags((~on_rim).astype(np.float64)) @ inner + sparse.diags(on_rim.astype(np.float64)) @ outer
    )
