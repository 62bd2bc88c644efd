"""Responses to light the plain way: one ``mi.render`` for each light, as a user without transport would.

It stands beside ``render.transport`` to be measured against: same surface and lights, Mitsuba's own renderer.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.jit import mi
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PlainRender:
    """What one light costs.

    Attributes:
        seconds: of one render.
        samples: paths per pixel that it took.
        variance: of one path, mean over the mask and the colours.
    """

    seconds: float
    samples: int
    variance: float


def plain_render(scene: SurfaceScene, mask: Array, samples: int, depth: int, runs: int = 2) -> PlainRender:
    """Render a scene under the light that it has.

    Args:
        scene: surface, camera and light.
        mask: (H, W), pixels above 0 count for the variance.
        samples: paths per pixel.
        depth: greatest path depth, as in Mitsuba: 2 is direct light.
        runs: renders that the variance is estimated from, at least 2.

    Returns:
        Least time, and variance between the renders times ``samples``.
    """
    integrator = mi.load_dict({"type": "path", "max_depth": depth, "hide_emitters": True})
    images, seconds = [], []
    for seed in range(runs):
        begin = time.perf_counter()
        image = mi.render(scene.mi_scene, integrator=integrator, spp=samples, seed=seed)
        images.append(np.asarray(image, dtype=np.float64)[..., :3])
        seconds.append(time.perf_counter() - begin)
    variance = np.var(images, axis=0, ddof=1)[mask > 0].mean() * samples
    return PlainRender(min(seconds), samples, float(variance))
