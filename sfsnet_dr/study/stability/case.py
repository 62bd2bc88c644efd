"""What a case is: inputs as data, and what is expected of every form that meets them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
from torch import Tensor

from sfsnet_dr.render.shading_inputs import COLOURS
from sfsnet_dr.study.stability.forms import Inputs
from sfsnet_dr.study.stability.truth import render_truth

Array = npt.NDArray[np.float64]
Leaves = dict[str, Array]
Rng = np.random.Generator

#: Bounds in units in the last place of a form's own scale (see ``truth``). A direction takes 4 roundings, a
#: polynomial of degree 2 twice that and 3, the sum of 9 terms 9: at most 20 halves of a unit in a value.
VALUE_ULP: Final = 10.0
#: Gradients pass the same roundings backwards and are then summed over pixels in blocks.
GRADIENT_ULP: Final = 16.0


@dataclass(frozen=True)
class Bound:
    """The form gives the right numbers.

    Attributes:
        value: largest error of a value in units in the last place of its scale.
        gradient: the same of gradients.
        floor: absolute error allowed besides, where numbers underflow.
        gradient_floor: the same of gradients.
        kink: where a derivative does not exist, which set the answer must lie in: ``"length"`` between the
            derivatives on both sides of the shortest normal; ``"residual"`` any slope of |x| at 0.
    """

    value: float = VALUE_ULP
    gradient: float = GRADIENT_ULP
    floor: float = 0.0
    gradient_floor: float = 0.0
    kink: Literal["length", "residual"] | None = None


@dataclass(frozen=True)
class NotFinite:
    """NaN or inf goes in. It must show where float64 shows it, and leave all other numbers right.

    The loss is one number: it must show it, and its gradients are not looked at.
    """


@dataclass(frozen=True)
class Refusal:
    """A BadInput whose line holds these words."""

    words: str


Expectation = Bound | NotFinite | Refusal


def by_name(leaves: dict[str, Tensor]) -> Inputs:
    """Leaves that are the arguments themselves."""
    return Inputs(**leaves)


@dataclass(frozen=True)
class Case:
    """One hard input.

    Attributes:
        group: heading on the page.
        name: what is hard about it.
        cause: why this is expected, for the page.
        leaves: makes named float64 arrays; ``image`` and ``mask`` are constants, all others get gradients.
        expect: what every form must do.
        build: makes the arguments from the leaves by views alone.
    """

    group: str
    name: str
    cause: str
    leaves: Callable[[Rng], Leaves]
    expect: Expectation = Bound()
    build: Callable[[dict[str, Tensor]], Inputs] = by_name


def ordinary(rng: Rng, batch: int = 2, height: int = 12, width: int = 12, order: int = 2) -> Leaves:
    """Unit normals all around, albedo .1 to 1, a light of mean 1, an image that is off, a mask.

    Row 0 of the mask is left out, row 1 counts fully, the others count partly.
    """
    shape = (batch, COLOURS, height, width)
    normal = rng.standard_normal(shape)
    light = 0.5 * rng.standard_normal((batch, COLOURS, (order + 1) ** 2))
    light[:, :, 0] = 3.5
    mask = rng.uniform(0.05, 1, (batch, 1, height, width))
    if height > 2:
        mask[:, :, 0], mask[:, :, 1] = 0, 1
    leaves = {
        "normal": normal / np.linalg.norm(normal, axis=1, keepdims=True),
        "albedo": rng.uniform(0.1, 1, shape),
        "light": light.reshape(batch, COLOURS * (order + 1) ** 2),
        "mask": mask,
    }
    return with_image(leaves, rng)


def with_image(leaves: Leaves, rng: Rng) -> Leaves:
    """Add the image: off by .1 to .5 of the scale everywhere, so that no rounding can turn a residual's sign.

    Where the scale is denormal it is off by .1 to .5, because the residual would be flushed to 0.
    """
    normal, albedo, light = leaves["normal"], leaves["albedo"], leaves["light"]
    found = render_truth(normal, albedo, light, np.zeros_like(albedo))
    off = rng.uniform(0.1, 0.5, albedo.shape) * rng.choice([-1.0, 1.0], albedo.shape)
    return leaves | {"image": found.value + off * np.where(found.scale > 1e-30, found.scale, 1)}


def changed(**changes: Callable[[Array], Array]) -> Callable[[Rng], Leaves]:
    """``ordinary`` inputs with some arguments changed, and the image that goes with them."""

    def make(rng: Rng) -> Leaves:
        leaves = ordinary(rng)
        return with_image(leaves | {name: change(leaves[name]) for name, change in changes.items()}, rng)

    return make


def poisoned(argument: str, value: float, row: int) -> Callable[[Rng], Leaves]:
    """``ordinary`` inputs with one number replaced; row 0 is masked out, row 1 counts."""

    def make(rng: Rng) -> Leaves:
        leaves = ordinary(rng)
        leaves[argument][(0, 0, row, 3) if leaves[argument].ndim == 4 else (0, 3)] = value
        return leaves

    return make
