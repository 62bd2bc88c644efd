"""What a camera looks at, without its light: the half of a scene that renderers are compared on."""

from __future__ import annotations

from dataclasses import dataclass, replace

from sfsnet_dr.scene.face import sample_face
from sfsnet_dr.scene.mesh import Mesh
from sfsnet_dr.scene.shapes import SHAPES
from sfsnet_dr.scene.spec import CameraSpec, SceneSpec


@dataclass(frozen=True, eq=False)
class Subject:
    """A surface before a camera.

    Attributes:
        spec: what it was made from; says its name, and whether it has gloss.
        seed: of a head; nothing else depends on it.
        mesh: the surface, in the frame of ``base.conventions``.
        camera: where the camera stands.
    """

    spec: SceneSpec
    seed: int
    mesh: Mesh
    camera: CameraSpec


def build_subject(spec: SceneSpec, seed: int = 0) -> Subject:
    """The surface that a spec describes, and the camera that looks at it."""
    if spec.shape in SHAPES:
        mesh = SHAPES[spec.shape](spec.albedo or (0.5, 0.5, 0.5))
        return Subject(spec, seed, mesh, replace(spec.camera, focal=None))
    face = sample_face(seed, spec)
    return Subject(spec, seed, face.mesh, face.pose.camera(spec.camera))
