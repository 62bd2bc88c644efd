"""What stands behind a face: the place that lights it, a wall, or blurred things in muted colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sfsnet_dr.base.color import LUMINANCE
from sfsnet_dr.scene.equirect import lookup
from sfsnet_dr.scene.lights import SceneLight

Array = NDArray[np.float64]


def sample_surroundings(rng: np.random.Generator, light: SceneLight, distance: float, size: int) -> Array:
    """A random background under the light of the face.

    Args:
        rng: the only source of randomness.
        light: what lights the face; walls and things are lit by its mean too, from nearly dark to fully.
        distance: of the camera, scene units: how wide it sees.
        size: width and height, pixels.

    Returns:
        Linear radiance (size, size, 3), at least 0.
    """
    kind = rng.choice(["place", "wall", "things"], p=[0.4, 0.25, 0.35])
    if kind == "place" and light.environment is not None:
        return behind(light.environment, distance, size)
    lit = light.face_shading() * np.exp(rng.uniform(np.log(0.1), 0.0))
    wall = _muted(rng)
    if kind == "things":
        return np.asarray(_patches(rng, wall, size) * lit)
    slope = rng.uniform(-0.5, 0.5, 2)
    across = np.linspace(-1.0, 1.0, size)
    shade = 1 + 0.5 * (slope[0] * across[None, :] + slope[1] * across[:, None])
    return np.asarray(shade[..., None] * wall * lit)


def behind(environment: Array, distance: float, size: int) -> Array:
    """The part of an environment map (H, W, 3) that a camera sees behind the face: (size, size, 3)."""
    across = (2 * np.arange(size) + 1) / size - 1
    x, y = np.meshgrid(across, -across)
    rays = np.stack([x, y, np.full_like(x, -distance)], axis=-1)
    return lookup(environment, rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def _patches(rng: np.random.Generator, mean: Array, size: int) -> Array:
    """Colours that vary over three scales around a mean, out of focus."""
    total = np.tile(np.log(mean), (size, size, 1))
    for cells, amount in ((3, 0.7), (6, 0.4), (16, 0.2)):
        grid = amount * (rng.normal(size=(cells, cells, 1)) + 0.3 * rng.normal(size=(cells, cells, 3)))
        at = np.linspace(0, cells - 1, size)
        places = np.stack(np.meshgrid(at, at, indexing="ij"))
        for channel in range(3):
            total[..., channel] += ndimage.map_coordinates(grid[..., channel], places, order=1)
    return np.asarray(np.minimum(np.exp(total), 1.0))


def _muted(rng: np.random.Generator) -> Array:
    """An albedo (3,) as walls, clothes and leaves have it."""
    color = rng.uniform(0.0, 1.0, 3)
    grey = color @ LUMINANCE
    color = grey + rng.beta(1.2, 3.0) * (color - grey)
    return np.asarray(
        np.clip(color * np.exp(rng.uniform(np.log(0.05), np.log(0.8))) / max(grey, 0.05), 0.01, 0.9)
    )
