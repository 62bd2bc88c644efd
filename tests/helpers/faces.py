"""What the tests of the face models share: many seeded heads, measured in one way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.faces.model import FaceModel, Stream, streams_of
from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.mesh import FACE_REGIONS, Region, vertex_normals
from sfsnet_dr.scene.spec import HeadSpec

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class HeadMeasures:
    """Measures of many seeded heads: arrays of (N,), lengths in decimetres.

    Attributes:
        finite: whether all positions are numbers.
        away: share of face vertices whose normal points away from a frontal camera.
        inverted: share of face vertices whose normal lies more than 90 degrees from the neutral head's.
        eye_distance: between the eyes' centres.
        iris_off: greatest distance of an iris from its eye's centre, in the image plane.
        eye_to_mouth, mouth_to_chin: heights.
    """

    finite: npt.NDArray[np.bool_]
    away: Array
    inverted: Array
    eye_distance: Array
    iris_off: Array
    eye_to_mouth: Array
    mouth_to_chin: Array


def away_share(model: FaceModel, normals: Array) -> float:
    """Share of face vertices whose normal points away from a frontal camera."""
    return float((normals[_on_face(model), 2] < 0).mean())


def measure_heads(model: FaceModel, head: HeadSpec, seeds: range) -> HeadMeasures:
    """Sample and measure the heads of the seeds, expressions included."""
    rows = np.array([_measure(model, head, seed) for seed in seeds])
    return HeadMeasures(rows[:, 0] == 1.0, *rows[:, 1:].T)


def _measure(model: FaceModel, head: HeadSpec, seed: int) -> list[float]:
    streams = streams_of(seed)
    shape = model.shape(Person.sample(streams(Stream.PERSON)), streams, head)
    normals = vertex_normals(shape.vertices, model.faces)
    face = _on_face(model)
    points = {name: shape.vertices[vertex] for name, vertex in model.landmarks.items()}
    mouth = (points["mouth_image_left"] + points["mouth_image_right"]) / 2
    side = model.weights.neutral[:, 0]
    irises = [
        shape.vertices[(model.labels == Region.IRIS) & (side * sign > 0)].mean(axis=0) for sign in (-1, 1)
    ]
    return [
        float(np.isfinite(shape.vertices).all() and np.isfinite(shape.eyes).all()),
        away_share(model, normals),
        float(((normals * model.normals).sum(axis=1)[face] < 0).mean()),
        float(np.linalg.norm(shape.eyes[1] - shape.eyes[0])),
        max(float(np.linalg.norm((a - b)[:2])) for a, b in zip(irises, shape.eyes, strict=True)),
        float(shape.eyes[:, 1].mean() - mouth[1]),
        float(mouth[1] - points["chin"][1]),
    ]


def _on_face(model: FaceModel) -> npt.NDArray[np.bool_]:
    return np.isin(model.labels, FACE_REGIONS) & (model.weights.mouth_inside < 0.5)
