"""Hard memory: the same numbers through views that are not plain (B, C, H, W) memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import torch
from torch import Tensor

from sfsnet_dr.experiments.stability.backends import Inputs
from sfsnet_dr.experiments.stability.cases import (
    Bound,
    Case,
    Leaves,
    Rng,
    default_case,
    find_case,
    with_image,
)

_VIEW: Final = "the layout does not change a bit of the numbers"
_IMAGES: Final = ("normal", "albedo", "image", "mask")


def _each(view: Callable[[Tensor], Tensor]) -> Callable[[dict[str, Tensor]], Inputs]:
    """Arguments that are views of the leaves, the light as it is."""
    return lambda leaves: Inputs(
        **{name: leaf if name == "light" else view(leaf) for name, leaf in leaves.items()}
    )


def _channels_last(image: Tensor) -> Tensor:
    return image.contiguous(memory_format=torch.channels_last)


def _stored(*dims: int) -> Callable[[Rng], Leaves]:
    """Images whose memory has its dimensions in another order."""

    def make(rng: Rng) -> Leaves:
        return {n: v.transpose(dims).copy() if n in _IMAGES else v for n, v in default_case(rng).items()}

    return make


def _wider(rng: Rng) -> Leaves:
    """Images with a margin that views leave out."""
    leaves = default_case(rng, 4, 25, 26)
    leaves["light"] = leaves["light"][:2]
    return leaves


def _single(*names: str) -> Callable[[Rng], Leaves]:
    """A batch of 3 of which some arguments have one entry for all."""

    def make(rng: Rng) -> Leaves:
        leaves = default_case(rng, batch=3)
        one = {name: leaves[name][:1] for name in names}
        full = {name: value.repeat(3, axis=0) for name, value in one.items()}
        return with_image(leaves | full, rng) | one

    return make


def _one_buffer(rng: Rng) -> Leaves:
    """Normals and albedo lie over each other in one buffer."""
    leaves = default_case(rng)
    buffer = rng.uniform(0.1, 1, 2 * 3 * 12 * 12 + 40)
    return {"buffer": buffer, "light": leaves["light"], "image": 10 + leaves["image"], "mask": leaves["mask"]}


def _windows(leaves: dict[str, Tensor]) -> Inputs:
    """Rows that overlap each other by most of their length, in normals and in albedo."""
    shape, strides = (2, 3, 12, 12), (150, 40, 3, 1)
    normal = leaves["buffer"].as_strided(shape, strides, 0)
    albedo = leaves["buffer"].as_strided(shape, strides, 7)
    return Inputs(normal, albedo, leaves["light"], leaves["image"], leaves["mask"])


def _constant(rng: Rng) -> Leaves:
    """One normal and one albedo for all pixels, one mask value; images bright enough to stay apart."""
    leaves = default_case(rng)
    first = {name: leaves[name][:, :, 1:2, 1:2] for name in ("normal", "albedo", "mask")}
    return leaves | first | {"image": 20 + leaves["image"]}


def _shared(rng: Rng) -> Leaves:
    leaves = default_case(rng)
    return {
        "both": leaves["normal"],
        "light": leaves["light"],
        "image": 20 + leaves["image"],
        "mask": leaves["mask"],
    }


def _all_one(rng: Rng) -> Leaves:
    leaves = default_case(rng)
    return {"all": 3 + leaves["normal"], "light": leaves["light"]}


def _case(
    name: str,
    leaves: Callable[[Rng], Leaves],
    build: Callable[[dict[str, Tensor]], Inputs],
    cause: str = _VIEW,
    expect: Bound | None = None,
) -> Case:
    return Case("Memory", name, cause, leaves, expect or Bound(), build)


#: All of them, in the order of the page.
CASES: Final = (
    _case("channels last", default_case, _each(_channels_last)),
    _case("stored as (H, W, C, B)", _stored(2, 3, 1, 0), _each(lambda t: t.permute(3, 2, 0, 1))),
    _case("stored as (B, H, W, C)", _stored(0, 2, 3, 1), _each(lambda t: t.permute(0, 3, 1, 2))),
    _case("every other image, row and column", _wider, _each(lambda t: t[::2, :, 1::2, 2::2])),
    _case("slices that start in the middle of a cache line", _wider, _each(lambda t: t[1:3, :, 3:14, 5:18])),
    _case(
        "one image of a batch, not aligned",
        _wider,
        lambda leaves: Inputs(**{n: leaf[1:2] for n, leaf in leaves.items()}),
    ),
    _case("one light for a batch", _single("light"), find_case),
    _case("one face for a batch", _single("normal", "albedo"), find_case),
    _case("one pixel expanded to images", _constant, _each(lambda t: t.expand(-1, -1, 12, 12))),
    _case(
        "windows that overlap in one buffer",
        _one_buffer,
        _windows,
        "gradients add up in the buffer",
        Bound(gradient=24),
    ),
    _case(
        "the same tensor as normal and albedo",
        _shared,
        lambda v: Inputs(v["both"], v["both"], v["light"], v["image"], v["mask"]),
        "both gradients add up",
        Bound(gradient=24),
    ),
    _case(
        "the same tensor as normal, albedo, image and mask",
        _all_one,
        lambda v: Inputs(v["all"], v["all"], v["light"], v["all"], v["all"][:, :1]),
        "image and mask get no gradient; any sign where a residual is small",
        Bound(kink="residual"),
    ),
)
