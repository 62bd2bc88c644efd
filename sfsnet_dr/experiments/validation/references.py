"""What a subject looks like under a light, traced to several depths: the levels that errors are split by.

Each level is a pair of images with independent noise. All first images of the levels share one seed, all
second ones another: within a family the noise is alike, so that it nearly cancels in the difference of two
levels, and products of the two families are free of noise.

Shading without shadows at several points of each pixel: the middle of the chain in ``study.causes``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from sfsnet_dr.render.aovs import TransportOptions, render_aovs
from sfsnet_dr.render.path_tracer import Reference, path_trace
from sfsnet_dr.scene.lights.equirect import MAP_SIZE, sample_map
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.scene_cache import SceneCache
from sfsnet_dr.scene.subject import Subject
from sfsnet_dr.sh.projection import equirect_directions, equirect_solid_angles

Image = npt.NDArray[np.float64]

_DIRECT, _BOUNCE, _ALL = 2, 3, -1  # Mitsuba's path depths


class IndependentPair(NamedTuple):
    """Two images of one thing with independent noise; the same image twice where there is none."""

    first: Image
    second: Image

    @property
    def mean(self) -> Image:
        """The best guess."""
        return (self.first + self.second) / 2


@dataclass(frozen=True)
class LightPathImages:
    """Path-traced images of one subject under one light.

    Attributes:
        direct: no gloss, light that meets the surface once.
        bounce: no gloss, at most one further surface point.
        diffuse: no gloss, any number of points.
        glossy_bounce: as ``bounce`` with gloss; None for a subject without.
        truth: everything that the subject has; the reference of all errors.
        variance: of one path's radiance in ``truth``, (H, W, 3).
        samples: paths per pixel of each image.
    """

    direct: IndependentPair
    bounce: IndependentPair
    diffuse: IndependentPair
    glossy_bounce: IndependentPair | None
    truth: IndependentPair
    variance: Image
    samples: int


def trace_light_paths(
    scenes: SceneCache, subject: Subject, light: Light, samples: int, seed: int
) -> LightPathImages:
    """Trace all levels.

    Args:
        scenes: kept from one light to the next.
        subject: what is seen.
        light: the light.
        samples: paths per pixel of each image.
        seed: any non-negative integer.
    """
    glossy = subject.spec.has_gloss
    plain = scenes.show(subject.mesh, subject.camera, light, gloss=False)
    (direct, bounce, every), noisy = _pairs(plain, samples, seed, (_DIRECT, _BOUNCE, _ALL))
    glossy_bounce, truth = None, every
    if glossy:
        (glossy_bounce, truth), noisy = _pairs(
            scenes.show(subject.mesh, subject.camera, light, gloss=True), samples, seed, (_BOUNCE, _ALL)
        )
    variance = (noisy[0].variance + noisy[1].variance) * (samples / 2)
    return LightPathImages(direct, bounce, every, glossy_bounce, truth, variance, samples)


def _pairs(
    scene: SurfaceScene, samples: int, seed: int, depths: tuple[int, ...]
) -> tuple[list[IndependentPair], tuple[Reference, Reference]]:
    """A pair for each depth, and both images of the last one with their variances."""
    pairs = []
    for depth in depths:
        first, second = (path_trace(scene, samples, 2 * seed + k, depth) for k in (0, 1))
        pairs.append(IndependentPair(first.mean, second.mean))
    return pairs, (first, second)


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
        seen = render_aovs(SurfaceScene(subject.mesh, camera), _RAYS, seed, TransportOptions(order=0))
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

    def truncated(self, light: Light, order: int) -> Array:
        """(H, W, 3) image by the light's expansion to an order, unclamped."""
        return self.shade(light.coefficients(order).to_shading().evaluate(self.normal))

    def complete(self, light: Light) -> Array:
        """(H, W, 3) image by all of the light, as if nothing shadowed anything.

        Lamps are exact. For a map the irradiance is summed over its texels for 64 x 128 normals and
        interpolated between them, which is right to about 0.1 %.
        """
        total = np.zeros_like(self.normal)
        if light.environment is not None:
            total += sample_map(irradiance_map(light.environment), self.normal) / np.pi
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
