"""One Dr.Jit kernel over all pixels of a batch, with sums over each image on the side.

A lane works through a run of packets of one image in a symbolic loop, so that the light is loaded once a
run, and sums (the light's gradient, the loss) stay in its registers. ``GROUP`` neighbouring lanes walk
through memory side by side. At the end each lane writes one row of sums, which a second, small kernel adds
up in a fixed order: no atomic operation is used, every run gives the same bits.

Nothing here is differentiated by Dr.Jit (symbolic loops would give wrong gradients); gradients are written
out by the kernels themselves.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import torch

from sfsnet_dr.render.drjit_interop import PACKET, Layout, Types
from sfsnet_dr.scene.jit import dr

#: Lanes that walk side by side: a vector of AVX-512. Fixed, so that results do not depend on the processor.
GROUP: Final = 16

#: Packets that a lane handles where images are large enough: loading the light is then a small share.
RUN: Final = 32

#: Groups of lanes that a small batch is split into, for machines with many cores.
FEWEST_GROUPS: Final = 16


class Structure(NamedTuple):
    """What of a call is neither in the kernel nor in the tensors' memory; each has a recording of its own.

    Attributes:
        batch: number of images.
        packets: packets in a channel of an image.
        run: packets that a lane handles where images are large enough.
        sums: numbers that the kernel sums over each image.
        steps: of each tensor, packets from one image to the next and from one channel to the next.
        same: of each tensor, the first one that lies at the same place. Dr.Jit tells the inputs of a
            recording apart by their addresses, so that a recording made with one tensor given twice would
            be wrong for two.
    """

    batch: int
    packets: int
    run: int
    sums: int
    steps: tuple[tuple[int, int], ...]
    same: tuple[int, ...]


class Lanes(NamedTuple):
    """Which packets each lane handles, as Dr.Jit arrays: ``start``, ``start + GROUP``, ... below ``end``.

    Attributes:
        image: the image of each lane.
        start: the lane's first packet within its image.
        end: first packet within the image that belongs to the next group.
        row: of each number that the summing kernel makes, where it begins.
        numbers: packets in a channel of an image, groups an image, and the structure's steps.
    """

    image: Any
    start: Any
    end: Any
    row: Any
    numbers: Any

    @property
    def plane(self) -> Any:
        """Packets in a channel of an image."""
        return self.number(0)

    @property
    def groups(self) -> Any:
        """Groups of lanes an image."""
        return self.number(1)

    def number(self, k: int) -> Any:
        """In a kernel: one of the numbers. They lie in memory, so that other ones need no other kernel."""
        index = type(self.numbers)
        return dr.gather(index, self.numbers, index(k))

    def source(self, k: int, values: Any) -> Source:
        """In a kernel: the k-th tensor of the structure, with its array."""
        return Source(values, self.number(2 + 2 * k), self.number(3 + 2 * k))


class Source(NamedTuple):
    """A tensor that a kernel reads: its array, and the steps of its ``View``."""

    values: Any
    image_step: Any
    channel_step: Any


#: (channels of each source, sums so far) of one pixel -> (channels of each output, sums).
Pixel = Callable[[list[list[Any]], list[Any]], tuple[list[list[Any]], list[Any]]]


def row_length(sums: int) -> int:
    """Numbers in a lane's row of sums: whole packets."""
    return -(-sums // PACKET) * PACKET


@functools.lru_cache(maxsize=256)
def lanes(kinds: Types, structure: Structure) -> Lanes:
    """Share the packets of every image among lanes."""
    batch, packets = structure.batch, structure.packets
    steps = -(-packets // GROUP)
    groups = min(steps, max(steps // structure.run, -(-FEWEST_GROUPS // batch)))
    length = -(-steps // groups) * GROUP
    image, group, lane = np.meshgrid(*map(np.arange, (batch, groups, GROUP)), indexing="ij")
    start = group * length + lane
    end = np.minimum((group + 1) * length, packets)
    row = row_length(max(structure.sums, 1))  # Dr.Jit has no variable for an empty array
    first = np.arange(batch)[:, None] * (groups * GROUP * row) + np.arange(GROUP * row)
    numbers = np.array([packets, groups, *(step for pair in structure.steps for step in pair)])
    # In torch's memory, which is aligned: Dr.Jit compiles other kernels for memory that is not.
    aligned = [
        torch.tensor(a.ravel(), dtype=torch.int32).numpy().view(np.uint32)
        for a in (image, start, end, first, numbers)
    ]
    return Lanes(*map(kinds.index, aligned))


@functools.lru_cache(maxsize=1024)
def real(kinds: Types, value: float) -> Any:
    """A real number in memory: kernels are not compiled again for another one."""
    found = dr.opaque(kinds.value, value)
    dr.sync_thread()
    return found


def sweep(
    kinds: Types,
    packet: int,
    lanes: Lanes,
    sources: Sequence[tuple[Layout, Source]],
    outputs: Sequence[tuple[Layout, int]],
    sums: int,
    pixel: Pixel,
    finish: Callable[[list[Any]], list[Any]] = list,
) -> tuple[list[Any], Any]:
    """Trace a kernel that calls ``pixel`` on every pixel of a batch.

    Args:
        packet: numbers in a packet.
        sources: what is read, with its layout.
        outputs: what is written: layout and number of floats. Images follow each other without gaps.
        sums: how many numbers are summed over each image; may be 0.
        pixel: traced once for each position in a packet.
        finish: applied once to the sums of every lane.

    Returns:
        The outputs as flat arrays; and the sums, ``GROUP`` rows of ``row_length`` an image, which are still
        to be added, or None.
    """
    read_from = [
        _Address(layout, lanes.image * source.image_step, source.channel_step) for layout, source in sources
    ]
    write_to = [
        _Address(layout, lanes.image * lanes.plane * layout.channels, lanes.plane) for layout, _ in outputs
    ]

    def body(at: Any, arrays: list[Any], totals: list[Any]) -> tuple[Any, list[Any], list[Any]]:
        read = [
            _load(kinds, packet, source.values, address, at)
            for (_, source), address in zip(sources, read_from, strict=True)
        ]
        written: list[list[list[Any]]] = []
        for i in range(packet):
            values, totals = pixel([[channel[i] for channel in image] for image in read], totals)
            written.append(values)
        for k, address in enumerate(write_to):
            _store(kinds, packet, arrays[k], address, at, [values[k] for values in written])
        return at + GROUP, arrays, totals

    arrays = [dr.empty(kinds.value, size) for _, size in outputs]
    state = (kinds.index(lanes.start), arrays, [kinds.value(0) for _ in range(sums)])
    _, arrays, totals = dr.while_loop(state, lambda at, *_: at < lanes.end, body, mode="symbolic")
    if not sums:
        return arrays, None
    rows = _rows(kinds, lanes, finish(totals))
    dr.eval(arrays, rows)
    return arrays, _add_groups(kinds, lanes, rows, row_length(sums))


class _Address(NamedTuple):
    """Where a lane's image begins, in packets, and what lies between its channels."""

    layout: Layout
    first: Any
    channel_step: Any

    def of(self, at: Any) -> list[Any]:
        """Packets that hold the pixels of packet ``at``: a plane each, or neighbours."""
        channels = range(self.layout.channels)
        if self.layout.interleaved:
            return [self.first + at * self.layout.channels + c for c in channels]
        return [self.first + at + self.channel_step * c for c in channels]


def _load(kinds: Types, packet: int, values: Any, address: _Address, at: Any) -> list[list[Any]]:
    """[channel][pixel in packet]."""
    read = [_gather(kinds, packet, values, index) for index in address.of(at)]
    if not address.layout.interleaved:
        return read
    joined = [value for packet_of_values in read for value in packet_of_values]
    return [joined[c :: address.layout.channels] for c in range(address.layout.channels)]


def _store(
    kinds: Types, packet: int, array: Any, address: _Address, at: Any, values: list[list[Any]]
) -> None:
    """Write [pixel in packet][channel]."""
    channels = [[pixel[c] for pixel in values] for c in range(address.layout.channels)]
    if address.layout.interleaved:
        joined = [value for pixel in values for value in pixel]
        channels = [joined[i : i + packet] for i in range(0, len(joined), packet)]
    for index, channel in zip(address.of(at), channels, strict=True):
        _scatter(kinds, array, channel, index)


def _gather(kinds: Types, packet: int, values: Any, index: Any) -> list[Any]:
    if packet == 1:
        return [dr.gather(kinds.value, values, index)]
    return list(dr.gather(kinds.packet, values, index, shape=(packet, dr.width(index))))


def _scatter(kinds: Types, array: Any, values: list[Any], index: Any) -> None:
    # No address occurs twice. (The default would look for conflicts.)
    value = values[0] if len(values) == 1 else kinds.packet(values)
    dr.scatter(array, value, index, mode=dr.ReduceMode.Permute)


def _rows(kinds: Types, lanes: Lanes, totals: list[Any]) -> Any:
    """Write the sums of each lane beside each other."""
    count, length = dr.width(lanes.image), row_length(len(totals))
    rows = dr.empty(kinds.value, count * length)
    padded = totals + [kinds.value(0)] * (length - len(totals))
    first = dr.arange(kinds.index, count) * (length // PACKET)
    for i in range(0, length, PACKET):
        _scatter(kinds, rows, padded[i : i + PACKET], first + i // PACKET)
    return rows


def _add_groups(kinds: Types, lanes: Lanes, rows: Any, length: int) -> Any:
    """Add the rows of all groups of an image, one after the other."""
    state = (kinds.index(0), kinds.index(lanes.row), kinds.value(0))

    def body(i: Any, at: Any, total: Any) -> tuple[Any, Any, Any]:
        return i + 1, at + GROUP * length, total + dr.gather(kinds.value, rows, at)

    return dr.while_loop(state, lambda i, *_: i < lanes.groups, body, mode="symbolic")[2]
