"""What a subject looks like under a light, traced to several depths: the levels that errors are split by.

Each level is a pair of images with independent noise. All first images of the levels share one seed, all
second ones another: within a family the noise is alike, so that it nearly cancels in the difference of two
levels, and products of the two families are free of noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sfsnet_dr.render.reference import Reference, path_trace
from sfsnet_dr.scene.lights import SceneLight
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.subject import Subject

Image = npt.NDArray[np.float64]

_DIRECT, _BOUNCE, _ALL = 2, 3, -1  # Mitsuba's path depths


class Pair(NamedTuple):
    """Two images of one thing with independent noise; the same image twice where there is none."""

    first: Image
    second: Image

    @property
    def mean(self) -> Image:
        """The best guess."""
        return (self.first + self.second) / 2


@dataclass(frozen=True)
class Levels:
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

    direct: Pair
    bounce: Pair
    diffuse: Pair
    glossy_bounce: Pair | None
    truth: Pair
    variance: Image
    samples: int


class Stage:
    """A subject's Mitsuba scenes, kept from one light to the next where the kind of light is the same."""

    def __init__(self, subject: Subject) -> None:
        self.subject = subject
        self._scenes: dict[tuple[bool, int, bool], SurfaceScene] = {}

    def lit(self, light: SceneLight, gloss: bool) -> SurfaceScene:
        """The scene under a light, with or without the glossy lobes; good until the next call."""
        key = (gloss, len(light.directional), light.environment is not None)
        if key not in self._scenes:
            self._scenes[key] = SurfaceScene(
                self.subject.mesh, self.subject.camera, light.directional, environment=key[2], gloss=gloss
            )
        scene = self._scenes[key]
        if light.directional:
            scene.set_directional(light.directional)
        if light.environment is not None:
            scene.set_environment(light.environment)
        return scene


def trace_levels(stage: Stage, light: SceneLight, samples: int, seed: int) -> Levels:
    """Trace all levels.

    Args:
        stage: of the subject.
        light: the light.
        samples: paths per pixel of each image.
        seed: any non-negative integer.
    """
    glossy = stage.subject.spec.has_gloss
    plain = stage.lit(light, gloss=False)
    (direct, bounce, every), noisy = _pairs(plain, samples, seed, (_DIRECT, _BOUNCE, _ALL))
    glossy_bounce, truth = None, every
    if glossy:
        (glossy_bounce, truth), noisy = _pairs(stage.lit(light, gloss=True), samples, seed, (_BOUNCE, _ALL))
    variance = (noisy[0].variance + noisy[1].variance) * (samples / 2)
    return Levels(direct, bounce, every, glossy_bounce, truth, variance, samples)


def _pairs(
    scene: SurfaceScene, samples: int, seed: int, depths: tuple[int, ...]
) -> tuple[list[Pair], tuple[Reference, Reference]]:
    """A pair for each depth, and both images of the last one with their variances."""
    pairs = []
    for depth in depths:
        first, second = (path_trace(scene, samples, 2 * seed + k, depth) for k in (0, 1))
        pairs.append(Pair(first.mean, second.mean))
    return pairs, (first, second)
