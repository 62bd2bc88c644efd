"""One seeded person: shape, expression, skin and pose, placed in the canonical face frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.faces.appearance import Appearance, skin_appearance
from sfsnet_dr.scene.faces.displacement import displace_mesh
from sfsnet_dr.scene.faces.model import FaceModel, HeadShape, Stream, Streams, streams_of
from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.faces.pose import Pose, place_head
from sfsnet_dr.scene.faces.registry import load_face_model
from sfsnet_dr.scene.mesh import Mesh, vertex_normals
from sfsnet_dr.scene.spec import SceneSpec

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Face:
    """A person in the camera frame.

    Attributes:
        mesh: the triangles with albedo, gloss and regions.
        landmarks: named points (3,): ``eye_image_left``, ``eye_image_right``, ``mouth_image_left``,
            ``mouth_image_right``, ``nose_tip``, ``chin``.
        pose: how the head was turned and placed, and how far away its camera stands.
        person: tone, sex and age.
        appearance: pigments and hair behind the albedo; None where scene or model give the albedo.
    """

    mesh: Mesh
    landmarks: dict[str, Array]
    pose: Pose
    person: Person
    appearance: Appearance | None


def sample_face(seed: int, spec: SceneSpec) -> Face:
    """The person of a seed, the same on every machine and in every process.

    Args:
        seed: any non-negative integer.
        spec: a scene whose shape is a face model.

    Raises:
        InputError: for another shape, or a missing or damaged model file.
    """
    model, streams = load_face_model(spec), streams_of(seed)
    person = Person.sample(streams(Stream.PERSON))
    shape = model.shape(person, streams, spec.head)
    if spec.head.ita_deg is not None:
        person = replace(person, tone=spec.head.ita_deg)
    albedo = _given_albedo(seed, spec, model)
    appearance = None
    if albedo is None:
        appearance = skin_appearance(model.weights, streams(Stream.ALBEDO), person)
        albedo = appearance.albedo
    vertices = shape.vertices
    if spec.head.relief:
        hair = appearance.hair if appearance else None
        vertices = displace_mesh(vertices, model.normals, model.weights, streams(Stream.RELIEF), person, hair)
    vertices = _deepened(vertices, shape.eyes, spec, streams)
    pose = Pose.sample(streams(Stream.POSE), spec.head, spec.camera)
    placed = place_head(np.vstack([shape.eyes, vertices]), shape.eyes, pose, pose.camera(spec.camera))
    mesh = Mesh(
        vertices=placed[2:],
        faces=model.faces,
        albedo=albedo,
        regions=appearance.labels(model.labels) if appearance else model.labels,
        normals=vertex_normals(placed[2:], model.faces),
        roughness_mix=appearance.roughness_mix if appearance else None,
    )
    landmarks = {"eye_image_left": placed[0], "eye_image_right": placed[1]}
    landmarks |= {name: placed[2 + vertex] for name, vertex in model.landmarks.items()}
    return Face(mesh, landmarks, pose, person, appearance)


def _deepened(vertices: Array, eyes: Array, spec: SceneSpec, streams: Streams) -> Array:
    """A head that is deeper, or flatter, than its model's: slopes times a factor, seen from the front."""
    if spec.head.depth_scale == (1.0, 1.0):  # also keeps the last bits of heads that were rendered before
        return vertices
    factor = streams(Stream.DEPTH).uniform(*spec.head.depth_scale)
    eye_level = eyes[:, 2].mean()
    deeper = vertices.copy()
    deeper[:, 2] = eye_level + factor * (vertices[:, 2] - eye_level)
    return deeper


def sample_shape(seed: int, spec: SceneSpec) -> HeadShape:
    """The head of a seed alone, in the common frame of the face models, without relief."""
    streams = streams_of(seed)
    return load_face_model(spec).shape(Person.sample(streams(Stream.PERSON)), streams, spec.head)


def _given_albedo(seed: int, spec: SceneSpec, model: FaceModel) -> Array | None:
    """The scene's one colour, or the model's own statistics; None asks for skin."""
    if spec.albedo is not None:
        return np.tile(np.asarray(spec.albedo, dtype=np.float64), (len(model.labels), 1))
    return model.colour(streams_of(seed))
