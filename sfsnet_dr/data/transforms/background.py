"""Backgrounds of training images, and the settings of all augmentations."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Final

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor
from torch.nn import functional

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.config import added_field
from sfsnet_dr.core.conventions import FACE_SIZE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.transforms.camera import PhotoOptions
from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.scene.lights.equirect import sample_map
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.lights.spec import LightSpec

Array = NDArray[np.float64]


def sample_surroundings(rng: np.random.Generator, light: Light, distance: float, size: int) -> Array:
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
        return sample_background(light.environment, distance, size)
    lit = light.face_shading() * np.exp(rng.uniform(np.log(0.1), 0.0))
    wall = _muted(rng)
    if kind == "things":
        return np.asarray(_patches(rng, wall, size) * lit)
    slope = rng.uniform(-0.5, 0.5, 2)
    across = np.linspace(-1.0, 1.0, size)
    shade = 1 + 0.5 * (slope[0] * across[None, :] + slope[1] * across[:, None])
    return np.asarray(shade[..., None] * wall * lit)


def sample_background(environment: Array, distance: float, size: int) -> Array:
    """The part of an environment map (H, W, 3) that a camera sees behind the face: (size, size, 3)."""
    across = (2 * np.arange(size) + 1) / size - 1
    x, y = np.meshgrid(across, -across)
    rays = np.stack([x, y, np.full_like(x, -distance)], axis=-1)
    return sample_map(environment, rays / np.linalg.norm(rays, axis=-1, keepdims=True))


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


#: Scales of what is behind a face: cells along each side, and standard deviation in the logarithm.
_SCALES: Final = ((3, 0.7), (6, 0.4), (16, 0.2))


@dataclass(frozen=True)
class Augmentation:
    """How training images are made from bundles.

    Args:
        size: width and height of the images; None keeps the bundles'.
        crop: how much of the frame they show: a square in its middle, in canonical pixels (of 128).
        num_val: bundles that are not trained on, to measure with.
        flip: probability of a left-right reflection.
        num_lights: how many lights are drawn before the first step and then used again, each time turned,
            white- balanced and exposed anew.
        light: their kinds, and the ranges of exposure and white balance.
        photo: what the camera does.

    Raises:
        InputError: for a value out of its range.
    """

    RENAMED: ClassVar[dict[str, str]] = {"held_back": "num_val", "lights": "num_lights"}

    size: int | None = None
    crop: int = added_field(FACE_SIZE)
    num_val: int = 0
    flip: float = 0.5
    num_lights: int = 4096
    light: LightSpec = field(default_factory=LightSpec)
    photo: PhotoOptions = field(default_factory=PhotoOptions)

    def __post_init__(self) -> None:
        if not 0 <= self.flip <= 1:
            raise InputError(f"flip: {self.flip} found, a probability from 0 to 1 is needed")
        limits = {
            "num_lights": (float(self.num_lights), 1.0, 1e6),
            "size": (float(self.size or 8), 8.0, 4096.0),
        }
        limits["crop"] = (float(self.crop), 8.0, float(FACE_SIZE))
        limits["num_val"] = (float(self.num_val), 0.0, 1e6)
        limits |= {f"light.{key}": limit for key, limit in self.light.limits().items()}
        for key, (value, low, high) in limits.items():
            if not low <= value <= high:
                raise InputError(f"{key}: {value:g} found, {low:g} to {high:g} allowed")
        if self.size is None and self.crop < FACE_SIZE:
            raise InputError(f"crop: {self.crop} found without size; say how many pixels are to show it")

    @property
    def view(self) -> Crop | None:
        """What of a bundle the images show; None for all of it as it is."""
        return None if self.size is None else Crop(self.size, self.crop)


def render_backgrounds(
    rng: np.random.Generator, lit: Array, place: Array, size: tuple[int, int], device: torch.device | str
) -> Tensor:
    """Linear backgrounds (B, 3, H, W), at least 0: a wall, blurred things, or the place that lights the face.

    The batch form of ``surroundings.sample_surroundings``: from coefficients a place has one colour only.

    Args:
        rng: the only source of randomness.
        lit: mean shading of a white face, (B, 3); walls and things get a tenth of it up to all.
        place: radiance from behind the face, (B, 3).
        size: height and width.
        device: where they are wanted.
    """
    count = len(lit)
    kind = rng.choice(3, (count, 1), p=[0.4, 0.25, 0.35])  # place, wall, things
    light = lit * np.exp(rng.uniform(np.log(0.1), 0.0, (count, 1)))
    colour = np.where(kind == 0, place, _muted_background(rng, count) * light)
    variety = np.choose(kind, [0.7, 0.1, 1.0])[..., None, None]
    total = torch.zeros(count, 3, 1, 1)
    for cells, amount in _SCALES:  # small grids first: the full size is interpolated once
        grey, tint = rng.normal(size=(count, 1, cells, cells)), rng.normal(size=(count, 3, cells, cells))
        grid = torch.from_numpy((amount * variety * (grey + 0.3 * tint)).astype(np.float32))
        total = grid + functional.interpolate(total, (cells, cells), mode="bilinear", align_corners=True)
    total = functional.interpolate(total.to(device), size, mode="bilinear", align_corners=True)
    brightest = torch.from_numpy(lit.astype(np.float32)).to(device)[:, :, None, None]
    base = torch.from_numpy(colour.astype(np.float32)).to(device)[:, :, None, None]
    things = (total.exp_() * base).clamp_min_(0)
    walled = torch.from_numpy(kind > 0).to(device)[..., None, None]
    return torch.where(walled, things.minimum(brightest), things)


def _muted_background(rng: np.random.Generator, count: int) -> Array:
    """Albedos (B, 3) as walls, clothes and leaves have them."""
    color = rng.uniform(0.0, 1.0, (count, 3))
    grey = (color @ LUMINANCE)[:, None]
    color = grey + rng.beta(1.2, 3.0, (count, 1)) * (color - grey)
    level = np.exp(rng.uniform(np.log(0.05), np.log(0.8), (count, 1)))
    return np.asarray(np.clip(color * level / np.maximum(grey, 0.05), 0.01, 0.9))
