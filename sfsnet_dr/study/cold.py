"""The first image of a process: every rung once, kernels compiled from nothing, in a process of its own.

Run as ``python -m sfsnet_dr.study.cold SIZE GLOSS`` with an empty ``DRJIT_CACHE_DIR``; prints JSON. Compiling
does not depend on the surface, so that it looks at a ball.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict, replace
from functools import partial
from typing import Any

from sfsnet_dr.base.checks import WorkFailed
from sfsnet_dr.study.timing import KernelTime, time_kernels

#: Seconds after which compiling is taken to hang.
_TIME_LIMIT = 300


def cold_times(size: int, gloss: bool) -> dict[str, KernelTime]:
    """Times of first calls by rung's key; by ``path`` for the path tracer, ``capture_KIND`` for captures.

    Args:
        size: edge of the image in pixels.
        gloss: whether the rung with gloss is there.

    Raises:
        WorkFailed: if the process fails or takes minutes.
    """
    command = [sys.executable, "-m", "sfsnet_dr.study.cold", str(size), str(int(gloss))]
    with tempfile.TemporaryDirectory() as empty:
        environment = os.environ | {"DRJIT_CACHE_DIR": empty}
        try:
            run = subprocess.run(
                command, env=environment, capture_output=True, text=True, timeout=_TIME_LIMIT
            )
        except subprocess.TimeoutExpired as error:
            raise WorkFailed(f"cold times: not done after {_TIME_LIMIT} s") from error
    if run.returncode:
        last = (run.stderr.strip().splitlines() or [f"exit code {run.returncode}"])[-1]
        raise WorkFailed(f"cold times: {last}")
    return {key: KernelTime(**times) for key, times in json.loads(run.stdout).items()}


def _main(size: int, gloss: bool) -> dict[str, KernelTime]:
    from sfsnet_dr.render.capture import CaptureOptions, capture
    from sfsnet_dr.render.reference import path_trace
    from sfsnet_dr.scene.jit import dr, mi
    from sfsnet_dr.scene.light_sets import natural
    from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
    from sfsnet_dr.scene.spec import CameraSpec, SamplingSpec, SceneSpec
    from sfsnet_dr.scene.subject import build_subject
    from sfsnet_dr.study.rungs import kernel_of, know, ladder_rungs, weights

    spec = SceneSpec("cold", "sphere", camera=CameraSpec(size=size), gloss=gloss)
    spec = replace(spec, sampling=SamplingSpec(transport=2, paths=1))
    subject, light, rungs = build_subject(spec), natural(0), ladder_rungs(gloss)
    dr.eval(dr.arange(mi.Float, 4) + 1.0)  # LLVM itself has to start once
    found = {}
    plain = SurfaceScene(subject.mesh, subject.camera)
    plain.set_environment(light.environment if light.environment is not None else 0.0)
    found["path"] = _first(partial(path_trace, plain, 4, 0))
    found["capture_analytic"] = _first(partial(capture, plain, 2, 0, CaptureOptions(order=0)))
    for kind in dict.fromkeys(rung.kind for rung in rungs if rung.kind != "analytic"):
        scene = SurfaceScene(subject.mesh, subject.camera, gloss=True) if kind == "gloss" else plain
        options = CaptureOptions(order=4, bounces=int(kind != "visibility"))
        found[f"capture_{kind}"] = _first(partial(capture, scene, 2, 0, options))
    known = know(subject, 0, rungs)
    for rung in rungs:
        inputs, values = known.inputs(rung), weights(rung, light.coefficients(rung.order))
        found[rung.key] = time_kernels(partial(kernel_of(rung), *inputs, *values))
    return found


def _first(work: Any) -> KernelTime:
    """A first call whose result is NumPy's; only its kernels are wanted."""
    return time_kernels(lambda: (work(), None)[1])


if __name__ == "__main__":
    times = _main(int(sys.argv[1]), bool(int(sys.argv[2])))
    print(json.dumps({key: asdict(value) for key, value in times.items()}))
