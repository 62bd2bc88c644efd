"""How fast rays can be traced at best, and where the time of a computation goes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sfsnet_dr.render.capture import covered_pixels
from sfsnet_dr.scene.jit import dr, mi, upload
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene, camera_rays


def bare_ray_tests(scene: SurfaceScene, per_pixel: int, seed: int = 0, repeats: int = 5) -> float:
    """Rays a second of ``scene.ray_test`` alone, on rays of the kind that transport is made of.

    The rays leave the points that the camera sees in cosine-distributed directions, another one for each
    ray; they are in memory before the clock starts, and nothing is done with the answer but to store it.

    Args:
        scene: surface and camera.
        per_pixel: rays from each pixel that shows something.
        seed: of the rays.
        repeats: the median of so many is taken.
    """
    pixels = np.tile(covered_pixels(scene), per_pixel)
    random = np.random.default_rng(seed).random((4, len(pixels)))
    x, y, u, v = (upload(mi.Float, row) for row in random)
    ray = camera_rays(scene.camera, upload(mi.UInt32, pixels), mi.Point2f(x, y))
    hit = scene.mi_scene.ray_intersect(ray, mi.RayFlags.Minimal | mi.RayFlags.ShadingFrame, coherent=True)
    found = hit.is_valid()
    away = hit.spawn_ray(hit.to_world(mi.warp.square_to_cosine_hemisphere(mi.Point2f(u, v))))
    dr.eval(away, found)
    count = float(dr.sum(dr.select(found, mi.Float64(1.0), 0.0)).numpy()[0])
    seconds = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        hidden = scene.mi_scene.ray_test(away, found)
        dr.eval(hidden)
        dr.sync_thread()
        seconds.append(time.perf_counter() - begin)
    return count / float(np.median(seconds[1:]))  # the first one compiles


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
