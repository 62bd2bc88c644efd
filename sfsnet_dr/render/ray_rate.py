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
    pixel = upload(mi.UInt32, covered_pixels(scene))
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
