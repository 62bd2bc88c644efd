"""Seeded people out of ICT FaceKit: 100 identity modes and ARKit-style expressions on a scanned topology."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import sparse

from sfsnet_dr.scene.faces import subdivision
from sfsnet_dr.scene.faces.expressions import gaze_weights, sample_expression
from sfsnet_dr.scene.faces.ict_files import VERTEX_COUNT, IctData, read_ict
from sfsnet_dr.scene.faces.ict_regions import (
    EYEBALLS,
    LANDMARKS,
    KeptMesh,
    eyeball_centres,
    ict_regions,
    kept_vertices,
)
from sfsnet_dr.scene.faces.model import (
    EYE_CENTRES,
    EYE_SURFACE,
    HeadShape,
    Stream,
    Streams,
    digest_of,
    find_landmarks,
)
from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.faces.regions import RegionWeights
from sfsnet_dr.scene.mesh import triangulate, vertex_normals
from sfsnet_dr.scene.spec import HeadSpec

Array = npt.NDArray[np.float64]

_SPREAD = (
    3.0  # standard deviation of the coefficients for ``HeadSpec.identity`` of 1: 0.9 for the default of 0.3
)
_EXTREME = 2.2  # coefficients beyond this many standard deviations are drawn again
_LIDS_AT_REST = (0.08, 0.28)  # of a full blink: the neutral face has its eyes wide open

_INNER_LIPS = (62, 66)  # landmarks in the middle of the upper and lower lip's inner edge
_PARTING_UNITS = ("mouthUpperUp", "mouthLowerDown")
_MOST_CLOSING = 0.5  # of a unit


class IctFace:
    """The ICT FaceKit head behind the ``FaceModel`` interface.

    Args:
        path: the compact file, a clone, or its ``FaceXModel`` folder.
        levels: Catmull-Clark subdivisions of the skin; eyes, teeth and gums stay as they are.

    Raises:
        InputError: for a missing, damaged or foreign file.
    """

    name = "ict"

    def __init__(self, path: Path, levels: int) -> None:
        files = read_ict(path)
        self.digest = digest_of(files.neutral, files.faces, files.identity, files.expression)
        mesh, scale = to_common_frame(files)
        self._neutral = mesh.neutral
        self._identity = scaled_modes(files.identity, mesh.kept, scale)
        self._expression = scaled_modes(files.expression, mesh.kept, scale)
        self._units = files.expression_names
        self._eyes = eyeball_centres(mesh)[::-1]  # image left first
        self._eye_modes = np.stack(
            [self._identity[:, mesh.part(eye)].mean(axis=1) for eye in EYEBALLS[::-1]], axis=1
        )
        self._gap_modes, self._gap_unit, self._lip_units = self._lip_gaps(mesh)
        self._refine, self.faces = _refined(mesh, levels)
        self.weights = _refined_weights(ict_regions(mesh), self._refine)
        self.labels = self.weights.labels()
        self.normals = vertex_normals(self.weights.neutral, self.faces)
        self.landmarks = find_landmarks(self.weights, self.labels)

    def shape(self, person: Person, streams: Streams, head: HeadSpec) -> HeadShape:
        """Random identity, expression and gaze. FaceKit's modes know no sex and age."""
        modes = _coefficients(streams(Stream.SHAPE), len(self._identity), _SPREAD * head.identity)
        units = sample_expression(self._units, streams(Stream.EXPRESSION), head)
        units += gaze_weights(self._units, streams(Stream.GAZE), _LIDS_AT_REST)
        units = np.minimum(units, 1.0) + self._closed_lips(modes)
        moved = np.tensordot(modes, self._identity, 1) + np.tensordot(
            units.astype(np.float32), self._expression, 1
        )
        eyes = self._eyes + np.tensordot(modes, self._eye_modes, 1) + EYE_SURFACE
        return HeadShape(np.asarray(self._refine @ (self._neutral + moved)), np.asarray(eyes))

    def _lip_gaps(self, mesh: KeptMesh) -> tuple[Array, float, Array]:
        """How far each identity mode, and the units that part the lips, open the middle of the mouth."""
        upper, lower = np.searchsorted(mesh.kept, LANDMARKS[list(_INNER_LIPS)])
        names = [unit + side for unit in _PARTING_UNITS for side in ("_L", "_R")]
        chosen = np.array([float(name in names) for name in self._units])
        gaps = self._expression[:, upper, 1] - self._expression[:, lower, 1]
        modes = self._identity[:, upper, 1] - self._identity[:, lower, 1]
        return modes.astype(np.float64), float(chosen @ gaps), chosen

    def _closed_lips(self, modes: npt.NDArray[np.float32]) -> Array:
        """Weights of the parting units, mostly negative, that undo what an identity does to closed lips.

        Without, the modes part the lips of half the people by a millimetre, and push them into each other on
        the other half.
        """
        opening = float(modes @ self._gap_modes) / self._gap_unit
        return np.asarray(-np.clip(opening, -_MOST_CLOSING, _MOST_CLOSING) * self._lip_units)

    def colour(self, streams: Streams) -> None:
        """None: the model's colour is left to the skin."""


def _coefficients(rng: np.random.Generator, count: int, spread: float) -> npt.NDArray[np.float32]:
    values = rng.normal(size=count)
    while (extreme := np.abs(values) > _EXTREME).any():
        values[extreme] = rng.normal(size=int(extreme.sum()))
    return np.asarray(spread * values, dtype=np.float32)


def to_common_frame(files: IctData) -> tuple[KeptMesh, float]:
    """The used part of the mesh, moved and scaled so that its eyeballs' centres are Anny's."""
    kept = kept_vertices()
    number = np.full(VERTEX_COUNT, -1, dtype=np.int64)
    number[kept] = np.arange(len(kept))
    faces = number[files.faces]
    faces = faces[(faces >= 0).all(axis=1)]
    is_triangle = faces[:, 2] == faces[:, 3]
    mesh = KeptMesh(
        kept=kept,
        neutral=files.neutral[kept].astype(np.float64),
        uv=_island(files)[kept],
        quads=faces[~is_triangle].astype(np.uint32),
        triangles=faces[is_triangle][:, :3].astype(np.uint32),
    )
    centres = eyeball_centres(mesh)[::-1]
    scale = float(np.ptp(EYE_CENTRES[:, 0]) / np.ptp(centres[:, 0]))
    neutral = (mesh.neutral - centres.mean(axis=0)) * scale + EYE_CENTRES.mean(axis=0)
    return KeptMesh(kept, neutral, mesh.uv, mesh.quads, mesh.triangles), scale


def _island(files: IctData) -> Array:
    """(V, 2) texture coordinates; a vertex on a seam gets those with the smaller u, which is the face's."""
    uv = np.full((VERTEX_COUNT, 2), np.inf)
    corner, place = files.faces.ravel(), files.uv[files.uv_faces.ravel()].astype(np.float64)
    order = np.argsort(-place[:, 0], kind="stable")
    uv[corner[order]] = place[order]
    return uv


def scaled_modes(
    modes: npt.NDArray[np.float16], kept: npt.NDArray[np.int64], scale: float
) -> npt.NDArray[np.float32]:
    """(K, V, 3) offsets of the kept vertices in decimetres."""
    # Contiguous: the products of ``shape`` would copy all of it each time otherwise.
    return np.ascontiguousarray(modes[:, kept].astype(np.float32) * np.float32(scale))


def _refined(mesh: KeptMesh, levels: int) -> tuple[sparse.csr_matrix, npt.NDArray[np.uint32]]:
    """Subdivision matrix and triangles: the skin is refined, what has triangles of its own is kept."""
    count, total = mesh.body_count, len(mesh.neutral)
    on_body = (mesh.quads < count).all(axis=1)
    body, rest = mesh.quads[on_body], np.concatenate([triangulate(mesh.quads[~on_body]), mesh.triangles])
    refine: sparse.csr_matrix = sparse.identity(count, format="csr")
    for _ in range(levels):
        step, body = subdivision.catmull_clark(body, refine.shape[0])
        refine = (step @ refine).tocsr()
    shift = refine.shape[0] - count
    matrix = sparse.block_diag([refine, sparse.identity(total - count)], format="csr")
    return matrix, np.concatenate([triangulate(body), rest + np.uint32(shift)]).astype(np.uint32)


def _refined_weights(weights: RegionWeights, refine: sparse.csr_matrix) -> RegionWeights:
    refined = {field.name: np.asarray(refine @ getattr(weights, field.name)) for field in fields(weights)}
    return RegionWeights(**refined)
