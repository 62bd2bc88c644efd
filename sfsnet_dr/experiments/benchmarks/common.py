"""Timing of contenders in turns, what bounds a time, and the kernel history of Dr.Jit."""

from __future__ import annotations

import shutil
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch

from sfsnet_dr.render.aovs import covered_pixels
from sfsnet_dr.render.drjit_interop import kernel_milliseconds
from sfsnet_dr.scene.jit import dr, mi, upload_array
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene, camera_rays

#: Calls in a row of one contender before the next has its turn, and for how many seconds at least; the
#: fastest counts. At first, threads of the contender before still wait for work in a loop that keeps a
#: core busy, which takes some milliseconds: many calls, where they are short.
IN_A_ROW: Final = 3
TURN_SECONDS: Final = 0.03

#: Bytes of each buffer for the copy bandwidth: beyond any cache.
COPY_BYTES: Final = 256 * 2**20


@dataclass(frozen=True)
class Times:
    """Seconds of one contender, one number a round."""

    rounds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Seconds."""
        return statistics.median(self.rounds)

    def interval(self) -> tuple[float, float]:
        """Second smallest and second largest round; of fewer than four, the smallest and the largest."""
        ordered = sorted(self.rounds)
        if len(ordered) >= 4:
            ordered = ordered[1:-1]
        return ordered[0], ordered[-1]

    def ratio(self, to: Times) -> tuple[float, tuple[float, float]]:
        """How many times as long the other takes: median over the rounds, and second smallest and largest."""
        ratios = Times(tuple(b / a for a, b in zip(self.rounds, to.rounds, strict=True)))
        return ratios.median, ratios.interval()

    def share(self, copy: Times, traffic: int) -> tuple[float, tuple[float, float]]:
        """``ratio`` to what copying ``traffic`` bytes would take at the bandwidth of a ``bandwidth_copy``."""
        scale = traffic / (2 * COPY_BYTES)
        ratio, (low, high) = self.ratio(copy)
        return scale * ratio, (scale * low, scale * high)


def time_in_turns(contenders: Mapping[str, Callable[[], Any]], rounds: int) -> dict[str, Times]:
    """Time every contender in every round, after two calls that may compile.

    Args:
        contenders: what to call, by name.
        rounds: how many times each has its turn.
    """
    for call in contenders.values():
        call()
        call()
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, call in contenders.items():
            seconds[name].append(_turn(call))
    return {name: Times(tuple(found)) for name, found in seconds.items()}


def make_copy(traffic: int) -> Callable[[], Any]:
    """What copies as many bytes as make ``traffic`` bytes read and written."""
    source = torch.ones(max(traffic // 8, 1))
    target = torch.empty_like(source)
    return lambda: target.copy_(source)


def bandwidth_copy() -> Callable[[], Any]:
    """What shows the copy bandwidth of the moment: ``COPY_BYTES`` read and as many written."""
    return make_copy(2 * COPY_BYTES)


def bytes_a_second(copy: Times) -> float:
    """The bandwidth that a ``bandwidth_copy`` showed, bytes read and written a second."""
    return 2 * COPY_BYTES / copy.median


def compiler_missing() -> str | None:
    """Why torch.compile cannot be measured here, or None."""
    if not any(shutil.which(name) for name in ("g++", "clang++", "c++")):
        return "no C++ compiler was found, which torch.compile needs"
    return None


def _turn(call: Callable[[], Any]) -> float:
    found: list[float] = []
    while len(found) < IN_A_ROW or sum(found) < TURN_SECONDS:
        found.append(_seconds(call))
    return min(found)


def _seconds(call: Callable[[], Any]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


#: Calls whose kernels are timed.
REPEATS: Final = 9


def describe_bound(call: Callable[[], Any], seconds: float, copy_seconds: float) -> str:
    """One sentence on what keeps a call from being faster.

    Args:
        call: what was timed.
        seconds: its time.
        copy_seconds: the time in which its bytes could be copied.
    """
    kernels = statistics.median(kernel_milliseconds(call) for _ in range(REPEATS)) / 1000
    outside = max(seconds - kernels, 0)
    parts = {"kernels": kernels, "outside of them": outside, "memory": copy_seconds}
    text = ", ".join(f"{name} {1e3 * part:.2f} ms" for name, part in parts.items())
    if outside > kernels:
        return f"{text}: bound by the cost of a call (Python, launches, mapping memory)"
    if copy_seconds > 0.6 * kernels:
        return f"{text}: bound by memory"
    return f"{text}: bound by instructions (arithmetic, and transposing packets between memory and lanes)"


def bare_ray_tests(scene: SurfaceScene, per_pixel: int, seed: int = 0, repeats: int = 5) -> float:
    """Rays a second of a bare loop of ``scene.ray_test``, on rays of the kind that transport is made of.

    The rays leave the points that the camera sees in cosine-distributed directions, another one in each turn,
    from random numbers; that a ray is hidden is counted, and nothing else is done. One kernel, as transport
    is one; with rays that lie in memory beforehand it would be a fifth slower.

    Args:
        scene: surface and camera.
        per_pixel: rays from each pixel that shows something.
        seed: of the rays.
        repeats: the median of so many is taken.
    """
    pixel = upload_array(mi.UInt32, covered_pixels(scene))
    ray = camera_rays(scene.camera, pixel, mi.Point2f(0.5, 0.5))
    hit = scene.mi_scene.ray_intersect(ray, mi.RayFlags.Minimal | mi.RayFlags.ShadingFrame, coherent=True)
    found = hit.is_valid()
    dr.eval(hit, found)
    rays = per_pixel * float(np.count_nonzero(np.asarray(found)))
    seconds = []
    for turn in range(repeats + 1):
        random = mi.PCG32(initstate=dr.opaque(mi.UInt64, seed + turn), initseq=mi.UInt64(pixel))
        begin = time.perf_counter()
        hidden = _count_hidden(scene, hit, found, random, dr.opaque(mi.UInt32, per_pixel))
        dr.eval(hidden)
        dr.sync_thread()
        seconds.append(time.perf_counter() - begin)
    return rays / float(np.median(seconds[1:]))  # the first one compiles


@dr.syntax
def _count_hidden(
    scene: SurfaceScene, hit: mi.SurfaceInteraction3f, found: mi.Bool, random: mi.PCG32, count: mi.UInt32
) -> mi.UInt32:
    hidden, turn = mi.UInt32(0), mi.UInt32(0)
    while turn < count:
        point = mi.Point2f(random.next_float32(), random.next_float32())
        away = hit.spawn_ray(hit.to_world(mi.warp.square_to_cosine_hemisphere(point)))
        hidden += dr.select(found & scene.mi_scene.ray_test(away, found), 1, 0)
        turn += 1
    return hidden


@dataclass(frozen=True)
class KernelTime:
    """One launch of a kernel.

    Attributes:
        lanes: its width.
        operations: in its intermediate representation.
        seconds: that it ran.
        compiled: whether it had to be compiled.
    """

    lanes: int
    operations: int
    seconds: float
    compiled: bool


def kernel_times(work: Callable[[], object]) -> list[KernelTime]:
    """The kernels that a computation launches, from Dr.Jit's own history."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        work()
        history = dr.kernel_history([dr.KernelType.JIT])
    return [
        KernelTime(
            lanes=int(entry["size"]),
            operations=int(entry["operation_count"]),
            seconds=entry["execution_time"] / 1e3,
            compiled=not entry["cache_hit"],
        )
        for entry in history
    ]
