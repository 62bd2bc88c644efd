"""Time of one image by where it goes, warm, frozen and cold.

    warm     the whole call on data in Dr.Jit's memory, kernels compiled: tracing, code generation, execution
    frozen   the same under ``dr.freeze``, which replays the kernel without tracing
    cold     the first call of a process with an empty kernel cache (``study.cold``)

Tracing is what is left of a warm call when the kernel history's code generation, compilation and execution
are taken off. The share of the copy bandwidth is taken on so many images at once that they do not fit into a
cache, against a copy of as many bytes a moment before: small images are bound by overhead instead.

Run as ``python -m sfsnet_dr.experiments.validation.timing SIZE GLOSS`` with an empty ``DRJIT_CACHE_DIR``; it
prints JSON. Compiling does not depend on the surface, so that it looks at a ball.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from typing import Any, Final

import numpy as np
import torch

from sfsnet_dr.core.errors import RunError
from sfsnet_dr.experiments.validation.models import ModelInputs, ShadingModel, light_weights, shading_kernel
from sfsnet_dr.scene.jit import dr, mi
from sfsnet_dr.scene.lights.light import Light

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
class ModelTime:
    """Times of one image of a model.

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


def time_model(known: ModelInputs, model: ShadingModel, light: Light) -> ModelTime:
    """Measure one model. The light matters to no time; projecting it onto harmonics is not counted."""
    function, inputs = shading_kernel(model), known.inputs(model)
    batch = -(-WORKING_SET // (model.bytes_per_pixel * known.mask.size))
    many = tuple(_tiled(planes, batch) for planes in inputs)
    radiance = light.coefficients(model.order)
    weighed = light_weights(model, radiance)
    # A light is new data for every image, so that putting it into Dr.Jit's memory counts too.
    warm = _medians(
        lambda: time_kernels(lambda: function(*inputs, *light_weights(model, radiance)), history=False)
    )
    parts = _medians(lambda: time_kernels(lambda: function(*inputs, *weighed)))
    quick = dr.freeze(function)
    frozen = _medians(
        lambda: time_kernels(lambda: quick(*inputs, *light_weights(model, radiance)), history=False)
    )
    bandwidth = copy_bandwidth()
    time_kernels(lambda: function(*many, *weighed))
    execution = min(time_kernels(lambda: function(*many, *weighed)).execution for _ in range(_BATCHES))
    pixels = batch * known.mask.size
    return ModelTime(
        warm=KernelTime(warm.total, parts.codegen, parts.backend, parts.execution),
        frozen=frozen.total,
        ns_per_pixel=1e9 * execution / pixels,
        copy_share=model.bytes_per_pixel * pixels / execution / bandwidth,
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


#: Seconds after which compiling is taken to hang.
_TIME_LIMIT = 300


def measure_cold_start(size: int, gloss: bool) -> dict[str, KernelTime]:
    """Times of first calls by model's key; by ``path`` for the path tracer, ``capture_KIND`` for captures.

    Args:
        size: edge of the image in pixels.
        gloss: whether the model with gloss is there.

    Raises:
        RunError: if the process fails or takes minutes.
    """
    command = [sys.executable, "-m", "sfsnet_dr.experiments.validation.timing", str(size), str(int(gloss))]
    with tempfile.TemporaryDirectory() as empty:
        environment = os.environ | {"DRJIT_CACHE_DIR": empty}
        try:
            run = subprocess.run(
                command, env=environment, capture_output=True, text=True, timeout=_TIME_LIMIT
            )
        except subprocess.TimeoutExpired as error:
            raise RunError(f"cold times: not done after {_TIME_LIMIT} s") from error
    if run.returncode:
        last = (run.stderr.strip().splitlines() or [f"exit code {run.returncode}"])[-1]
        raise RunError(f"cold times: {last}")
    return {key: KernelTime(**times) for key, times in json.loads(run.stdout).items()}


def _main(size: int, gloss: bool) -> dict[str, KernelTime]:
    from sfsnet_dr.experiments.validation.models import (
        capture_inputs,
        light_weights,
        shading_kernel,
        shading_models,
    )
    from sfsnet_dr.render.aovs import TransportOptions, render_aovs
    from sfsnet_dr.render.path_tracer import path_trace
    from sfsnet_dr.scene.jit import dr, mi
    from sfsnet_dr.scene.lights.presets import natural_light
    from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
    from sfsnet_dr.scene.spec import CameraSpec, SamplingSpec, SceneSpec
    from sfsnet_dr.scene.subject import build_subject

    spec = SceneSpec("cold", "sphere", camera=CameraSpec(size=size), gloss=gloss)
    spec = replace(spec, sampling=SamplingSpec(spp=2, paths_per_hit=1))
    subject, light, models = build_subject(spec), natural_light(0), shading_models(gloss)
    dr.eval(dr.arange(mi.Float, 4) + 1.0)  # LLVM itself has to start once
    found = {}
    plain = SurfaceScene(subject.mesh, subject.camera)
    plain.set_environment(light.environment if light.environment is not None else 0.0)
    found["path"] = _first(partial(path_trace, plain, 4, 0))
    found["capture_analytic"] = _first(partial(render_aovs, plain, 2, 0, TransportOptions(order=0)))
    for kind in dict.fromkeys(model.kind for model in models if model.kind != "analytic"):
        scene = SurfaceScene(subject.mesh, subject.camera, gloss=True) if kind == "gloss" else plain
        options = TransportOptions(order=4, bounces=int(kind != "visibility"))
        found[f"capture_{kind}"] = _first(partial(render_aovs, scene, 2, 0, options))
    known = capture_inputs(subject, 0, models)
    for model in models:
        inputs, values = known.inputs(model), light_weights(model, light.coefficients(model.order))
        found[model.key] = time_kernels(partial(shading_kernel(model), *inputs, *values))
    return found


def _first(work: Any) -> KernelTime:
    """A first call whose result is NumPy's; only its kernels are wanted."""
    return time_kernels(lambda: (work(), None)[1])


if __name__ == "__main__":
    times = _main(int(sys.argv[1]), bool(int(sys.argv[2])))
    print(json.dumps({key: asdict(value) for key, value in times.items()}))
