"""Path-traced reference images with the variance of every pixel's mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.visualize import png_bytes, show_linear
from sfsnet_dr.scene.jit import dr, mi
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene, camera_rays

Image = npt.NDArray[np.float64]

#: Camera rays that are traced at once; more need more passes, not more memory.
_WAVEFRONT = 1 << 21


@dataclass(frozen=True)
class Reference:
    """An unbiased image.

    Attributes:
        mean: (H, W, 3) linear radiance of the surface; 0 where nothing was hit.
        variance: (H, W, 3) variance of ``mean``, estimated from the samples.
        samples: paths per pixel.
    """

    mean: Image
    variance: Image
    samples: int

    def _repr_png_(self) -> bytes:
        """The mean as sRGB, for notebooks."""
        return png_bytes(show_linear(self.mean))


def path_trace(scene: SurfaceScene, samples: int, seed: int, depth: int = -1) -> Reference:
    """Trace paths through every pixel under a box filter.

    Light that reaches the camera without meeting the surface is left out, so that pixels at the silhouette
    hold the surface's share alone, as in ``capture``.

    Args:
        scene: surface, camera and lights.
        samples: paths per pixel, at least 2.
        seed: any non-negative integer; two seeds give independent images.
        depth: 2 is direct light, 3 adds one bounce, -1 has no limit.

    Raises:
        InputError: for fewer than 2 samples: they would have no variance.
    """
    if samples < 2:
        raise InputError(f"samples: {samples} found, at least 2 are needed for a variance")
    size = scene.camera.size
    integrator = mi.load_dict({"type": "path", "max_depth": depth, "hide_emitters": True})
    total = np.zeros((3, size * size))
    squares = np.zeros((3, size * size))
    per_pass = max(1, min(samples, _WAVEFRONT // (size * size)))
    for first in range(0, samples, per_pass):
        count = min(per_pass, samples - first)
        part, part_squares = _trace(scene, integrator, count, _pass_seed(seed, first))
        total += part
        squares += part_squares
    mean = total / samples
    variance = np.maximum(squares / samples - mean**2, 0.0) / (samples - 1)
    return Reference(_image(mean, size), _image(variance, size), samples)


def _trace(scene: SurfaceScene, integrator: mi.Integrator, count: int, seed: int) -> tuple[Image, Image]:
    """Sums and sums of squares over ``count`` paths of every pixel: (3, pixels) each."""
    pixels = scene.camera.size**2
    sampler = mi.load_dict({"type": "independent", "sample_count": count})
    sampler.seed(dr.opaque(mi.UInt32, seed), pixels * count)
    pixel = dr.arange(mi.UInt32, pixels * count) // dr.opaque(mi.UInt32, count)
    ray = mi.RayDifferential3f(camera_rays(scene.camera, pixel, sampler.next_2d()))
    radiance, _, _ = integrator.sample(scene.mi_scene, sampler, ray)
    dr.eval(radiance)
    samples = np.asarray(radiance, dtype=np.float64).reshape(3, pixels, count)
    return samples.sum(axis=2), (samples**2).sum(axis=2)


def _pass_seed(seed: int, first: int) -> int:
    return int(np.random.SeedSequence((seed, first)).generate_state(1)[0])


def _image(values: Image, size: int) -> Image:
    return np.moveaxis(values.reshape(3, size, size), 0, -1)
