"""Edge cases: inputs as data, and the expected result of every backend."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
from torch import Tensor

from sfsnet_dr.experiments.stability.backends import Inputs
from sfsnet_dr.experiments.stability.expected import expected_image
from sfsnet_dr.render.shading_numpy import COLOURS
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.kernel import band_of, clamped_cosine

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
class ExpectedNonFinite:
    """NaN or inf goes in. It must show where float64 shows it, and leave all other numbers right.

    The loss is one number: it must show it, and its gradients are not looked at.
    """


@dataclass(frozen=True)
class ExpectedError:
    """A InputError whose line holds these words."""

    words: str


Expectation = Bound | ExpectedNonFinite | ExpectedError


def find_case(leaves: dict[str, Tensor]) -> Inputs:
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
    build: Callable[[dict[str, Tensor]], Inputs] = find_case


def default_case(rng: Rng, batch: int = 2, height: int = 12, width: int = 12, order: int = 2) -> Leaves:
    """Unit normals all around, albedo 0.1 to 1, a light of mean 1, an image that is off, a mask.

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
    """Add the image: off by 0.1 to 0.5 of the scale everywhere, so that no rounding can turn a residual's
    sign.

    Where the scale is denormal it is off by 0.1 to 0.5, because the residual would be flushed to 0.
    """
    normal, albedo, light = leaves["normal"], leaves["albedo"], leaves["light"]
    found = expected_image(normal, albedo, light, np.zeros_like(albedo))
    off = rng.uniform(0.1, 0.5, albedo.shape) * rng.choice([-1.0, 1.0], albedo.shape)
    return leaves | {"image": found.value + off * np.where(found.scale > 1e-30, found.scale, 1)}


def with_values(**changes: Callable[[Array], Array]) -> Callable[[Rng], Leaves]:
    """``default_case`` inputs with some arguments changed, and the image that goes with them."""

    def make(rng: Rng) -> Leaves:
        leaves = default_case(rng)
        return with_image(leaves | {name: change(leaves[name]) for name, change in changes.items()}, rng)

    return make


def with_nan(argument: str, value: float, row: int) -> Callable[[Rng], Leaves]:
    """``default_case`` inputs with one number replaced; row 0 is masked out, row 1 counts."""

    def make(rng: Rng) -> Leaves:
        leaves = default_case(rng)
        leaves[argument][(0, 0, row, 3) if leaves[argument].ndim == 4 else (0, 3)] = value
        return leaves

    return make


#: Smallest normal float32.
_TINY: Final = 2.0**-126
#: A shading value is a sum of at most 25 products of which each may be flushed, times an albedo of at most 1.
_FLOOR: Final = 25 * _TINY

_ROUNDING: Final = "rounding only"
_FLUSH: Final = (
    "Dr.Jit's threads set denormals (below 1.2e-38) to 0, going in and coming out; torch keeps them"
)
_SHORT: Final = "below |n| = 1e-6 the divisor is 1e-6: a short normal counts as less of a direction"
_KEPT: Final = "NaN and inf are shown where they belong and nowhere else"


def _ring(z: float, wobble: float = 0.0) -> Callable[[Array], Array]:
    """Unit normals all around the axis, of nearly one z."""

    def change(normal: Array) -> Array:
        angle = np.linspace(0, 2 * np.pi, normal[:, 0].size).reshape(normal[:, 0].shape)
        height = z + wobble * np.cos(7 * angle)
        radius = np.sqrt(1 - height**2)
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)

    return change


def _axes(normal: Array) -> Array:
    """The six directions along the axes, again and again."""
    six = np.concatenate([np.eye(3), -np.eye(3)])
    batch, _, height, width = normal.shape
    order = np.arange(batch * height * width) % 6
    return np.ascontiguousarray(np.moveaxis(six[order].reshape(batch, height, width, 3), -1, 1))


def _times(factor: float) -> Callable[[Array], Array]:
    return lambda values: factor * values


def _lengths(low: float, high: float) -> Callable[[Array], Array]:
    """Lengths spread evenly over powers of ten, side by side in one image."""

    def change(normal: Array) -> Array:
        exponents = np.linspace(np.log10(low), np.log10(high), normal.shape[2])
        return normal * 10.0 ** exponents[:, None]

    return change


def _bands(*kept: int) -> Callable[[Array], Array]:
    return lambda light: light * np.tile(np.isin(band_of(2), kept), 3)


def _ringing(light: Array) -> Array:
    """Order-2 shading of one directional light: it goes below 0 on 29 % of a sphere."""
    direction = np.array([0.48, 0.6, 0.64])
    flat = sh_basis(direction, 2) * clamped_cosine(2)[band_of(2)]
    return np.tile(flat, (len(light), 3))


def _order(order: int) -> Callable[[Rng], Leaves]:
    return lambda rng: default_case(rng, order=order)


def _size(batch: int, height: int, width: int) -> Callable[[Rng], Leaves]:
    return lambda rng: default_case(rng, batch, height, width)


def _black(rng: Rng) -> Leaves:
    leaves = default_case(rng)
    return leaves | {"albedo": 0 * leaves["albedo"], "image": 0 * leaves["image"]}


def _solved(rng: Rng) -> Leaves:
    """An image that is the render itself, up to round-off."""
    leaves = default_case(rng)
    found = expected_image(
        leaves["normal"], leaves["albedo"], leaves["light"], np.zeros_like(leaves["albedo"])
    )
    return leaves | {"image": found.value}


def _mask(value: float) -> Callable[[Rng], Leaves]:
    return with_values(mask=lambda mask: np.full_like(mask, value))


def _binary(mask: Array) -> Array:
    return np.round(mask)


def _case(
    title: str, cause: str, leaves: Callable[[Rng], Leaves], expect: Bound | ExpectedError | None = None
) -> Case:
    group, _, name = title.partition(": ")
    return Case(group, name, cause, leaves, expect or Bound())


_LENGTH_CASES = (
    _case("Normals: grazing, z within 1e-4 of 0", _ROUNDING, with_values(normal=_ring(0.0, 1e-4))),
    _case("Normals: back-facing, z from -1 to -.8", _ROUNDING, with_values(normal=_ring(-0.9, 0.1))),
    _case("Normals: along the axes and the poles", _ROUNDING, with_values(normal=_axes)),
    _case("Normals: lengths .1 to 10", _ROUNDING, with_values(normal=_lengths(0.1, 10))),
    _case(
        "Normals: lengths 1e10 to 1e37",
        f"shortened before squared; gradients of 1e-37: {_FLUSH}",
        with_values(normal=_lengths(1e10, 1e37)),
        Bound(gradient_floor=_FLOOR),
    ),
    _case("Normals: lengths 1e-5 to .1", _ROUNDING, with_values(normal=_lengths(1e-5, 0.1))),
    _case("Normals: lengths 1e-20 to 1e-7", _SHORT, with_values(normal=_lengths(1e-20, 1e-7))),
    _case("Normals: zero", _SHORT, with_values(normal=_times(0))),
    _case("Normals: denormal, 1e-40", f"{_FLUSH}; {_SHORT}", with_values(normal=_times(1e-40))),
)

_LIGHT_CASES = (
    _case("Light and albedo: light 1e-8", _ROUNDING, with_values(light=_times(1e-8))),
    _case("Light and albedo: light 1e8", _ROUNDING, with_values(light=_times(1e8))),
    _case(
        "Light and albedo: all coefficients negative",
        _ROUNDING,
        with_values(light=lambda light: -np.abs(light)),
    ),
    _case("Light and albedo: only band 2", _ROUNDING, with_values(light=_bands(2))),
    _case("Light and albedo: ringing, shading below 0", "not clamped", with_values(light=_ringing)),
    _case("Light and albedo: light 0", "exact", with_values(light=_times(0))),
    _case(
        "Light and albedo: light denormal, 1e-40",
        _FLUSH,
        with_values(light=_times(1e-40)),
        Bound(floor=_FLOOR, gradient_floor=100 * _FLOOR),
    ),
    _case("Light and albedo: albedo 0", "exact", with_values(albedo=_times(0))),
    _case("Light and albedo: albedo 1e4", _ROUNDING, with_values(albedo=_times(1e4))),
    _case(
        "Light and albedo: albedo 1e4 under light 1e8",
        _ROUNDING,
        with_values(albedo=_times(1e4), light=_times(1e8)),
    ),
    _case(
        "Light and albedo: albedo denormal, 1e-40",
        _FLUSH,
        with_values(albedo=_times(1e-40)),
        Bound(floor=_FLOOR, gradient_floor=100 * _FLOOR),
    ),
    _case("Light and albedo: order 0", _ROUNDING, _order(0)),
    _case("Light and albedo: order 4", _ROUNDING, _order(4), Bound(value=30, gradient=60)),
)

_SHAPE_CASES = (
    _case("Shape and mask: image 1 x 1", _ROUNDING, _size(1, 1, 1)),
    _case("Shape and mask: 17 images of 1 x 3", _ROUNDING, _size(17, 1, 3)),
    _case("Shape and mask: 128 x 128, shared by threads", _ROUNDING, _size(2, 128, 128)),
    _case("Shape and mask: mask of 0 and 1", _ROUNDING, with_values(mask=_binary)),
    _case("Shape and mask: mask 0", "0 by definition", _mask(0.0)),
    _case("Shape and mask: mask 1e-30", "the divisor is at least 1", _mask(1e-30)),
    _case(
        "Shape and mask: empty batch",
        "nothing to render",
        _size(0, 4, 4),
        ExpectedError("no empty dimension"),
    ),
    _case(
        "Shape and mask: image of no rows",
        "nothing to render",
        _size(1, 0, 4),
        ExpectedError("no empty dimension"),
    ),
)

_KINK_CASES = (
    _case("Kinks: residual 0 where albedo and image are black", "the slope of |x| at 0 is 0", _black),
    _case(
        "Kinks: residual 0 up to round-off",
        "any slope of |x| between -1 and 1 is right",
        _solved,
        Bound(kink="residual"),
    ),
    _case(
        "Kinks: normals of the shortest length, 1e-6",
        "between the derivatives of both sides",
        with_values(normal=_times(1e-6)),
        Bound(kink="length"),
    ),
    _case(
        "Kinks: the same along the axes",
        "between the derivatives of both sides",
        with_values(normal=lambda n: 1e-6 * _axes(n)),
        Bound(kink="length"),
    ),
    _case(
        "Kinks: components of equal length",
        "shortening has no derivative",
        with_values(normal=lambda n: 5 * np.sign(n)),
    ),
)

_WHERE = {0: "masked out", 1: "counted"}
_POISON_CASES = tuple(
    Case(
        "NaN and inf",
        f"{value} in {argument}, {place}",
        _KEPT,
        with_nan(argument, value, row),
        ExpectedNonFinite(),
    )
    for argument in ("normal", "albedo", "image")
    for value in (np.nan, np.inf)
    for row, place in _WHERE.items()
) + tuple(
    Case("NaN and inf", f"{value} in {argument}", _KEPT, with_nan(argument, value, 1), ExpectedNonFinite())
    for argument in ("light", "mask")
    for value in (np.nan, np.inf)
)

#: All of them, in the order of the page.
CASES: Final = (*_LENGTH_CASES, *_LIGHT_CASES, *_SHAPE_CASES, *_KINK_CASES, *_POISON_CASES)
