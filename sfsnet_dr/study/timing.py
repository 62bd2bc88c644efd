"""Where the time of one image goes: tracing, compiling, executing; and how near execution is to a plain copy.

    warm     the whole call on data in Dr.Jit's memory, kernels compiled: tracing, code generation, execution
    frozen   the same under ``dr.freeze``, which replays the kernel without tracing
    cold     the first call of a process with an empty kernel cache (``study.cold``)

Tracing is what is left of a warm call when the kernel history's code generation, compilation and execution
are taken off. The share of the copy bandwidth is taken on so many images at once that they do not fit into a
cache, against a copy of as many bytes a moment before: small images are bound by overhead instead.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
import torch

from sfsnet_dr.scene.jit import dr, mi
from sfsnet_dr.scene.lights import SceneLight
from sfsnet_dr.study.rungs import Known, Rung, kernel_of, weights

#: Bytes that the batch of images moves: more than the last cache of common processors holds.
WORKING_SET: Final = 128 << 20

_WARM_UP, _REPEATS, _BATCHES = 5, 30, 7


@dataclass(frozen=True)
class KernelTime:
    """Seconds by where they go, as the kernel history tells them apart.

    Attributes:
        total: wall time of the call.
        codegen: generating code, a cache's look-up included.
        backend: compiling it by LLVM, or loading it from disk.
        execution: running it.
    """

    total: float
    codegen: float
    backend: float
    execution: float

    @property
    def tracing(self) -> float:
        """What Python and Dr.Jit spend before there is code, and all other overhead."""
        return max(self.total - self.codegen - self.backend - self.execution, 0.0)


@dataclass(frozen=True)
class RungTime:
    """Times of one image of a rung.

    Attributes:
        warm: medians of a compiled call.
        frozen: wall seconds under ``dr.freeze``, median.
        ns_per_pixel: of a batch of images, execution alone.
        copy_share: bytes that the batch must move over those that a copy moves in the same time.
    """

    warm: KernelTime
    frozen: float
    ns_per_pixel: float
    copy_share: float


def time_rung(known: Known, rung: Rung, light: SceneLight) -> RungTime:
    """Measure one rung. The light matters to no time; projecting it onto harmonics is not counted."""
    function, inputs = kernel_of(rung), known.inputs(rung)
    batch = -(-WORKING_SET // (rung.bytes_per_pixel * known.mask.size))
    many = tuple(_tiled(planes, batch) for planes in inputs)
    radiance = light.coefficients(rung.order)
    weighed = weights(rung, radiance)
    # A light is new data for every image, so that putting it into Dr.Jit's memory counts too.
    warm = _medians(lambda: time_kernels(lambda: function(*inputs, *weights(rung, radiance)), history=False))
    parts = _medians(lambda: time_kernels(lambda: function(*inputs, *weighed)))
    quick = dr.freeze(function)
    frozen = _medians(lambda: time_kernels(lambda: quick(*inputs, *weights(rung, radiance)), history=False))
    bandwidth = copy_bandwidth()
    time_kernels(lambda: function(*many, *weighed))
    execution = min(time_kernels(lambda: function(*many, *weighed)).execution for _ in range(_BATCHES))
    pixels = batch * known.mask.size
    return RungTime(
        warm=KernelTime(warm.total, parts.codegen, parts.backend, parts.execution),
        frozen=frozen.total,
        ns_per_pixel=1e9 * execution / pixels,
        copy_share=rung.bytes_per_pixel * pixels / execution / bandwidth,
    )


def time_kernels(work: Callable[[], Any], *, history: bool = True) -> KernelTime:
    """One call, its result evaluated and waited for; the parts are 0 without ``history``."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, history):
        dr.kernel_history_clear()
        begin = time.perf_counter()
        result = work()
        dr.eval(result)
        dr.sync_thread()
        total = time.perf_counter() - begin
        kernels = dr.kernel_history([dr.KernelType.JIT]) if history else []
    parts = (sum(kernel[key] for kernel in kernels) / 1e3 for key in _HISTORY)
    return KernelTime(total, *parts)


@cache
def _buffers() -> tuple[torch.Tensor, torch.Tensor]:
    return torch.ones(WORKING_SET // 8), torch.zeros(WORKING_SET // 8)


def copy_bandwidth() -> float:
    """Bytes a second, read and written, of the fastest of a few copies with all threads."""
    source, target = _buffers()
    seconds = []
    for _ in range(_BATCHES):
        begin = time.perf_counter()
        target.copy_(source)
        seconds.append(time.perf_counter() - begin)
    return WORKING_SET / min(seconds)


_HISTORY: Final = ("codegen_time", "backend_time", "execution_time")


def _medians(measure: Callable[[], KernelTime]) -> KernelTime:
    for _ in range(_WARM_UP):
        measure()
    found = [measure() for _ in range(_REPEATS)]
    medians = (float(np.median([getattr(t, name) for t in found])) for name in KernelTime.__annotations__)
    return KernelTime(*medians)


def _tiled(planes: Any, count: int) -> Any:
    """Planes of one image as those of ``count`` images one after another."""
    if isinstance(planes, list):
        return [_tiled(plane, count) for plane in planes]
    tiled = type(planes)(dr.tile(planes, count)) if isinstance(planes, mi.Float) else dr.tile(planes, count)
    dr.eval(tiled)
    return tiled
