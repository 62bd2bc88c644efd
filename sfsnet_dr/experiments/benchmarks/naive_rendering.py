"""Transport rendered naively, one ``mi.render`` per light, and the noise of transport.

It stands beside ``render.transport`` to be measured against: same surface and lights, Mitsuba's own renderer.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sfsnet_dr.render.aovs import TransportMaps
from sfsnet_dr.scene.jit import mi
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class NaiveRender:
    """What one light costs.

    Attributes:
        seconds: of one render.
        samples: paths per pixel that it took.
        variance: of one path, mean over the mask and the colours.
    """

    seconds: float
    samples: int
    variance: float


def render_naively(scene: SurfaceScene, mask: Array, samples: int, depth: int, runs: int = 2) -> NaiveRender:
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
    return NaiveRender(min(seconds), samples, float(variance))


@dataclass(frozen=True)
class Noise:
    """Noise of one capture, relative to the image that a white sky gives.

    Attributes:
        transport, gloss, lamps: root mean square over responses, face pixels and colours; gloss is 0 for a
            surface without.
    """

    transport: float
    gloss: float
    directional: float


@dataclass(frozen=True)
class Variances:
    """Mean variance of the responses of each kind."""

    transport: float
    gloss: float
    directional: float


def measure_noise(captures: list[TransportMaps]) -> Noise:
    """Noise of one capture, estimated from several."""
    white = np.mean([maps.transport[0] for maps in captures], axis=0)[captures[0].mask > 0]
    scale = float(np.sqrt(np.mean(white**2)))
    spread = response_variances(captures)
    return Noise(
        *(float(np.sqrt(value)) / scale for value in (spread.transport, spread.gloss, spread.directional))
    )


def response_variances(captures: list[TransportMaps]) -> Variances:
    """Mean variance over face pixels, colours and the responses of a kind."""
    mask = captures[0].mask > 0

    def mean_variance(images: list[npt.NDArray[np.float32]]) -> float:
        if not len(images[0]):
            return 0.0
        return float(np.var(np.stack(images, dtype=np.float64), axis=0, ddof=1)[:, mask].mean())

    return Variances(
        mean_variance([maps.transport for maps in captures]),
        mean_variance([maps.gloss for maps in captures]),
        mean_variance([maps.directional for maps in captures]),
    )
