"""One call of a kernel of ``drjit_lanes`` from torch: the kernel that fits, its inputs and its results."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final, NamedTuple, cast

import torch
from torch import Tensor

from sfsnet_dr.base import runtime
from sfsnet_dr.render.drjit_lanes import GROUP, RUN, Lanes, Source, lanes, number, row_length
from sfsnet_dr.render.drjit_memory import (
    PACKET,
    Layout,
    Types,
    packet_size,
    shaped,
    to_drjit,
    to_torch,
    types,
    view,
)
from sfsnet_dr.render.drjit_pixel import folded
from sfsnet_dr.scene.jit import dr

#: Recordings of one frozen function, one for each shape of images, above which the oldest is dropped.
RECORDINGS: Final = 64

#: Frozen functions are recorded and replayed by one thread at a time.
_LOCK = threading.Lock()


class Signature(NamedTuple):
    """What a kernel has to be compiled for.

    Attributes:
        kinds: Dr.Jit's types for the tensors' device and dtype.
        packet: numbers in a packet.
        light_size: coefficients of an image's light.
        layouts: of the images that it reads.
    """

    kinds: Types
    packet: int
    light_size: int
    layouts: tuple[Layout, ...]

    def load_light(self, lanes: Lanes, light: Source) -> list[Any]:
        """In a kernel: the folded light of each lane's image."""
        first = lanes.image * light.image_step
        return folded([dr.gather(self.kinds.value, light.values, first + k) for k in range(self.light_size)])

    def reads(self, sources: Sequence[Source]) -> list[tuple[Layout, Source]]:
        """In a kernel: its sources with their layouts."""
        return list(zip(self.layouts, sources, strict=True))


class Call:
    """A kernel's inputs: images (B, C, H, W) of one shape but for C, and light (B, 3K), all of one dtype."""

    def __init__(
        self,
        images: Sequence[Tensor],
        light: Tensor,
        dense: int = 0,
        *,
        packet: int = PACKET,
        run: int = RUN,
    ) -> None:
        """``dense``: how many of the last images have to lie without gaps; packet, run: for experiments.

        Raises:
            BadInput: for a device or dtype that Dr.Jit does not have, or in a process that was forked after
                Dr.Jit had started.
        """
        runtime.check_process()
        first = images[0]
        self._shape, self._images, self._run = tuple(first.shape), images, run
        pixels = first.shape[2] * first.shape[3]
        kinds, packet = types(first.device.type, first.dtype), packet_size(pixels, packet)
        views = [view(x, packet, dense=k >= len(images) - dense) for k, x in enumerate(images)]
        self.signature = Signature(kinds, packet, light.shape[1], tuple(v.layout for v in views))
        self.sources = [
            Source(
                to_drjit(v.values, kinds.value), number(kinds, v.image_step), number(kinds, v.channel_step)
            )
            for v in views
        ]
        self._light = self._light_source(light)

    def launch(self, kernel: Callable[..., Any], sums: int, *arguments: Any) -> list[Any]:
        """Run ``kernel(lanes, sources, light, *arguments)`` to its end, from any thread.

        Args:
            kernel: ``frozen``, returns a list of arrays.
            sums: how many numbers it sums over each image.
        """
        batch, _, height, width = self._shape
        kinds, packet = self.signature.kinds, self.signature.packet
        if self._images[0].device.type == "cuda":  # Dr.Jit computes on a stream of its own
            torch.cuda.current_stream(self._images[0].device).synchronize()
        with _LOCK, _no_collection():
            which = lanes(kinds, batch, height * width // packet, sums, self._run)
            results: list[Any] = kernel(which, self.sources, self._light, *arguments)
            dr.eval(results)
            dr.sync_thread()
        return results

    def image(self, like: int, array: Any) -> Tensor:
        """A result as (B, C, H, W), in the layout of one of the images."""
        return shaped(self.signature.layouts[like], to_torch(array), self._shape)

    def per_image(self, sums: Any, count: int) -> Tensor:
        """What the kernel summed, (B, count)."""
        return to_torch(sums).view(self._shape[0], GROUP, row_length(count)).sum(1)[:, :count]

    def _light_source(self, light: Tensor) -> Source:
        """Light that is expanded over the batch is not copied for each image."""
        kinds = self.signature.kinds
        one = (light[:1] if light.stride(0) == 0 else light).contiguous()
        step = number(kinds, 0 if one.shape[0] == 1 else one.shape[1])
        return Source(to_drjit(one.view(-1), kinds.value), step, number(kinds, 1))


def frozen(kernel: Callable[..., list[Any]]) -> Callable[..., list[Any]]:
    """Record a kernel's launches once for each shape of images, and replay them afterwards.

    Args:
        kernel: (lanes, sources, light, *arguments) -> arrays.
    """

    def recorded(
        lanes: tuple[Any, ...], sources: list[tuple[Any, ...]], light: tuple[Any, ...], *rest: Any
    ) -> list[Any]:
        return kernel(Lanes(*lanes), [Source(*source) for source in sources], Source(*light), *rest)

    replayed = dr.freeze(recorded, limit=RECORDINGS, warn_after=10**6)

    def call(lanes: Lanes, sources: Sequence[Source], light: Source, *rest: Any) -> list[Any]:
        # Dr.Jit looks for arrays in plain tuples and lists, not in named ones.
        return cast(list[Any], replayed(tuple(lanes), [tuple(s) for s in sources], tuple(light), *rest))

    return call


@contextmanager
def _no_collection() -> Iterator[None]:
    """Keep the garbage collector from freeing shared memory amid a recording, which ends the process."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def plain(x: Tensor) -> Tensor:
    """A parameter or another subclass as what it is in memory, differentiably."""
    return x.as_subclass(Tensor)
