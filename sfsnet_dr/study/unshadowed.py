"""Shading without shadows at several points of each pixel: the middle of the chain in ``study.causes``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.render.capture import CaptureOptions, capture
from sfsnet_dr.scene.equirect import MAP_SIZE, lookup
from sfsnet_dr.scene.lights import SceneLight
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.subject import Subject
from sfsnet_dr.sh.projection import equirect_directions, equirect_solid_angles

Array = npt.NDArray[np.float64]

#: Points along each edge of a pixel, and camera rays for each of them.
EDGE: Final = 4
_RAYS = 4

_CHUNK = 512  # texels whose irradiance is summed at once


@dataclass(frozen=True)
class FineMaps:
    """Normals and albedo inside of pixels.

    Attributes:
        pixels: (H, W) which pixels are known.
        normal: (P, EDGE^2, 3) unit vectors, 0 where nothing is seen.
        albedo: (P, EDGE^2, 3) times the share that is covered.
    """

    pixels: npt.NDArray[np.bool_]
    normal: Array
    albedo: Array

    @staticmethod
    def of(subject: Subject, mask: Array, seed: int) -> FineMaps:
        """Capture the pixels with a positive mask (H, W)."""
        size = subject.camera.size
        camera = replace(subject.camera, size=EDGE * size)
        seen = capture(SurfaceScene(subject.mesh, camera), _RAYS, seed, CaptureOptions(order=0))
        chosen = mask > 0
        normal, albedo = (
            _by_pixel(values, size)[chosen]
            for values in (seen.normal, seen.albedo * seen.coverage[..., None])
        )
        return FineMaps(chosen, normal, albedo)

    def shade(self, shading: Array) -> Array:
        """(H, W, 3) image of shadings (P, EDGE^2, 3) at the points; 0 at other pixels."""
        image = np.zeros((*self.pixels.shape, 3))
        image[self.pixels] = (self.albedo * shading).mean(axis=1)
        return image

    def truncated(self, light: SceneLight, order: int) -> Array:
        """(H, W, 3) image by the light's expansion to an order, unclamped."""
        return self.shade(light.coefficients(order).to_shading().evaluate(self.normal))

    def complete(self, light: SceneLight) -> Array:
        """(H, W, 3) image by all of the light, as if nothing shadowed anything.

        Lamps are exact. For a map the irradiance is summed over its texels for 64 x 128 normals and
        interpolated between them, which is right to about .1 %.
        """
        total = np.zeros_like(self.normal)
        if light.environment is not None:
            total += lookup(irradiance_map(light.environment), self.normal) / np.pi
        for toward, power in light.directional:
            total += np.maximum(self.normal @ toward, 0.0)[..., None] * power / np.pi
        return self.shade(total)


def irradiance_map(environment: Array) -> Array:
    """Irradiance (64, 128, 3) on surfaces that face each direction of a map (64, 128, 3) of radiance."""
    directions = equirect_directions(*MAP_SIZE).reshape(-1, 3)
    power = (environment * equirect_solid_angles(*MAP_SIZE)[..., None]).reshape(-1, 3)
    total = np.zeros_like(power)
    for first in range(0, len(directions), _CHUNK):
        part = slice(first, first + _CHUNK)
        total += np.maximum(directions @ directions[part].T, 0.0) @ power[part]
    return total.reshape(*MAP_SIZE, 3)


def _by_pixel(values: npt.NDArray[np.float32], size: int) -> Array:
    """(EDGE H, EDGE W, C) to (H, W, EDGE^2, C)."""
    blocks = values.reshape(size, EDGE, size, EDGE, values.shape[-1]).swapaxes(1, 2)
    return blocks.reshape(size, size, EDGE * EDGE, values.shape[-1]).astype(np.float64)
