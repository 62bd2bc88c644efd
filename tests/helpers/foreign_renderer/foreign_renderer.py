"""Renderers of somebody else: a ball by formula, and one for each way to fail."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.render.renderers.base import Budget, Capabilities
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.subject import Subject

Image = NDArray[np.floating]


class Lambert:
    """A convex ball about the origin under directional lights, one ray through the middle of each pixel."""

    name = "foreign-lambert"
    capabilities = Capabilities(visibility=True)

    def render(self, subject: Subject, light: Light, budget: Budget) -> Image:
        size, distance = subject.camera.size, subject.camera.distance
        radius = float(np.linalg.norm(subject.mesh.vertices[0]))
        across = (np.arange(size) + 0.5) / size * 2 - 1
        x, y = np.broadcast_arrays(across[None, :], -across[:, None])
        ray = np.stack([x, y, np.full_like(x, -distance)], axis=-1)
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        along = distance * ray[..., 2]
        inside = along**2 - distance**2 + radius**2
        hit = ray * (-along - np.sqrt(np.maximum(inside, 0)))[..., None] + [0, 0, distance]
        shading = sum(
            np.maximum(hit @ toward, 0)[..., None] / radius * power / np.pi
            for toward, power in light.directional
        )
        return np.asarray(subject.mesh.albedo[0] * shading * (inside > 0)[..., None])


class _Plain:
    """What the failing ones have in common."""

    name = "foreign"
    capabilities = Capabilities(visibility=False)


class Raises(_Plain):
    def render(self, subject: Subject, light: Light, budget: Budget) -> Image:
        raise ValueError(f"first line\nno idea of {subject.spec.name}")


class Hangs(_Plain):
    def render(self, subject: Subject, light: Light, budget: Budget) -> Image:
        while True:
            time.sleep(60)


class Exits(_Plain):
    def render(self, subject: Subject, light: Light, budget: Budget) -> Image:
        print("this library is too old", flush=True)
        os.abort()


class WrongShape(_Plain):
    def render(self, subject: Subject, light: Light, budget: Budget) -> Image:
        return np.zeros((3, subject.camera.size, subject.camera.size))


class NotANumber(_Plain):
    def render(self, subject: Subject, light: Light, budget: Budget) -> Image:
        image = np.zeros((subject.camera.size, subject.camera.size, 3))
        image[0, 0, 0] = np.nan
        return image


class Integers(_Plain):
    def render(self, subject: Subject, light: Light, budget: Budget) -> Any:
        return np.zeros((subject.camera.size, subject.camera.size, 3), dtype=np.uint8)


class Lists(_Plain):
    def render(self, subject: Subject, light: Light, budget: Budget) -> Any:
        return [[[0.0, 0.0, 0.0]]]
