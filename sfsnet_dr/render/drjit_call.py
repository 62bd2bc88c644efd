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
from sfsnet_dr.render.drjit_lanes import GROUP, RUN, Lanes, Source, Structure, lanes, row_length
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

#: Recordings of one frozen function, one for each structure of a call, above which the oldest is dropped.
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
        one, light_step = _light(light)
        flat = [*(v.values for v in views), one]
        self._arrays = [to_drjit(x, kinds.value) for x in flat]
        places = [x.data_ptr() for x in flat]
        self._structure = Structure(
            batch=first.shape[0],
            packets=pixels // packet,
            run=run,
            sums=0,
            steps=(*((v.image_step, v.channel_step) for v in views), (light_step, 1)),
            same=tuple(places.index(place) for place in places),
        )

    def launch(self, kernel: Callable[..., Any], sums: int, *arguments: Any) -> list[Any]:
        """Run ``kernel(lanes, sources, light, *arguments)`` to its end, from any thread.

        Args:
            kernel: ``frozen``, returns a list of arrays.
            sums: how many numbers it sums over each image.
        """
        structure = self._structure._replace(sums=sums)
        if self._images[0].device.type == "cuda":  # Dr.Jit computes on a stream of its own
            torch.cuda.current_stream(self._images[0].device).synchronize()
        with _LOCK, _no_collection():
            which = lanes(self.signature.kinds, structure)
            results: list[Any] = kernel(structure, which, self._arrays, *arguments)
            dr.eval(results)
            dr.sync_thread()
        return results

    def image(self, like: int, array: Any) -> Tensor:
        """A result as (B, C, H, W), in the layout of one of the images."""
        return shaped(self.signature.layouts[like], to_torch(array), self._shape)

    def per_image(self, sums: Any, count: int) -> Tensor:
        """What the kernel summed, (B, count)."""
        return to_torch(sums).view(self._shape[0], GROUP, row_length(count)).sum(1)[:, :count]


def frozen(kernel: Callable[..., list[Any]]) -> Callable[..., list[Any]]:
    """Record a kernel's launches once for each structure of a call, and replay them afterwards.

    Args:
        kernel: (lanes, sources, light, *arguments) -> arrays.
    """

    def recorded(_: Structure, lanes: tuple[Any, ...], arrays: list[Any], *rest: Any) -> list[Any]:
        known = Lanes(*lanes)
        *sources, light = [known.source(k, values) for k, values in enumerate(arrays)]
        return kernel(known, sources, light, *rest)

    replayed = dr.freeze(recorded, limit=RECORDINGS, warn_after=10**6)

    def call(structure: Structure, lanes: Lanes, arrays: list[Any], *rest: Any) -> list[Any]:
        # Dr.Jit looks for arrays in plain tuples and lists, and compares named tuples as a whole.
        return cast(list[Any], replayed(structure, tuple(lanes), arrays, *rest))

    return call


def _light(light: Tensor) -> tuple[Tensor, int]:
    """Flat light, and the step to the next image's. One that is expanded is not copied for each image."""
    one = (light[:1] if light.stride(0) == 0 else light).contiguous()
    return one.view(-1), 0 if one.shape[0] == 1 else one.shape[1]


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
    return x if type(x) is Tensor else x.as_subclass(Tensor)
