"""What all face models share: fixed triangles, regions and landmarks, and a shape for each seed.

Convention: heads stand in Anny's frame. Decimetres, y up, z toward the viewer, x to the image right; eyeball
centres near (+-.308, 7.28, 1.25). Other models are brought there by a similarity transform, so that skin and
relief, which are laid out on the neutral head, fit all of them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.faces.regions import RegionWeights
from sfsnet_dr.scene.mesh import Region
from sfsnet_dr.scene.spec import HeadSpec

Array = npt.NDArray[np.float64]

#: Eyeball centres of the common frame, image left first.
EYE_CENTRES = np.array([[-0.30775, 7.28415, 1.24535], [0.30775, 7.28415, 1.24535]])

#: From an eyeball's centre to the plane of the lids: where photographs show the eye.
EYE_SURFACE = np.array([0.0, 0.0, 0.11])


class Stream(IntEnum):
    """Independent random streams of one person, so that a change in one does not move the others."""

    SHAPE = 0
    EXPRESSION = 1
    ALBEDO = 2
    POSE = 3
    PERSON = 4
    GAZE = 5
    RELIEF = 6
    DEPTH = 7


Streams = Callable[[Stream], np.random.Generator]


@dataclass(frozen=True)
class HeadShape:
    """One person's head in the common frame, up to a shift: tall people hold theirs higher.

    Attributes:
        vertices: (V, 3) decimetres.
        eyes: (2, 3) centres of the eyes' openings, image left first.
    """

    vertices: Array
    eyes: Array


class FaceModel(Protocol):
    """What a face model offers. All of it but ``shape`` and ``colour`` is the same for every person.

    Attributes:
        name: the scene's ``shape``.
        digest: hash of the model's numbers, the same for every way to read them.
        faces: (F, 3) triangles, counter-clockwise seen from outside.
        weights: soft regions, laid out on the neutral head.
        labels: (V,) values of ``Region``.
        normals: (V, 3) unit normals of the neutral head.
        landmarks: name -> vertex; see ``find_landmarks``.
    """

    name: str
    digest: str
    faces: npt.NDArray[np.uint32]
    weights: RegionWeights
    labels: npt.NDArray[np.uint8]
    normals: Array
    landmarks: dict[str, int]

    def shape(self, person: Person, streams: Streams, head: HeadSpec) -> HeadShape:
        """The head of a person; identity, expression and gaze draw from streams of their own."""
        ...

    def colour(self, streams: Streams) -> Array | None:
        """(V, 3) linear albedo out of the model's own colour statistics, None if it has none."""
        ...


def streams_of(seed: int) -> Streams:
    """The random streams of a seed, the same on every machine."""
    return lambda purpose: np.random.default_rng((seed, int(purpose)))


def find_landmarks(weights: RegionWeights, labels: npt.NDArray[np.uint8]) -> dict[str, int]:
    """Vertices of ``mouth_image_left``, ``mouth_image_right``, ``nose_tip`` and ``chin`` of a head."""
    side, height, depth = weights.neutral.T
    lips = np.flatnonzero(labels == Region.LIPS)
    middle = np.flatnonzero((labels == Region.SKIN) & (np.abs(side) < 0.04))
    below, above = middle[height[middle] < 6.45], middle[height[middle] > 6.7]
    return {
        "mouth_image_left": int(lips[side[lips].argmin()]),
        "mouth_image_right": int(lips[side[lips].argmax()]),
        "nose_tip": int(above[depth[above].argmax()]),
        "chin": int(below[height[below].argmin()]),
    }


def digest_of(*arrays: npt.NDArray[np.generic]) -> str:
    """A short hash of arrays' bytes."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]
