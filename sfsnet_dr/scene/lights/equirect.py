"""Environment maps as pictures: looked up, turned, and brought to the size that a scene takes.

Convention of maps: that of ``sh.projection``. Files of other programs put the centre of row i at
v = (i + 1/2) / H, not i / (H - 1); ``resample_map`` goes from there to here.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sfsnet_dr.sh.projection import equirect_directions

Array = npt.NDArray[np.float64]

#: Rows and columns of a scene's map; texels of 2.8 degrees, which resolve the sharpest lobe of ``sh.priors``.
MAP_SIZE = (64, 128)

_STEPS = 16  # midpoints a source pixel in the integrals of ``resample_map``


def sample_map(image: Array, directions: Array) -> Array:
    """Radiance (..., C) from unit directions (..., 3): the bilinear function of the map (H, W, C)."""
    height, width, _ = image.shape
    u = np.arctan2(directions[..., 0], -directions[..., 2]) / (2 * np.pi)
    v = np.arccos(np.clip(directions[..., 1], -1.0, 1.0)) / np.pi
    column, row = (u % 1.0) * width - 0.5, v * (height - 1)
    left, top = np.floor(column).astype(int), np.minimum(row.astype(int), height - 2)
    across, down = (column - left)[..., None], (row - top)[..., None]
    left, right = left % width, (left + 1) % width
    upper = (1 - across) * image[top, left] + across * image[top, right]
    lower = (1 - across) * image[top + 1, left] + across * image[top + 1, right]
    return np.asarray((1 - down) * upper + down * lower)


def turn_map(image: Array, rotation: Array) -> Array:
    """The map (H, W, C) of the surroundings after a rotation (3, 3): what was at d is at rotation @ d.

    Each texel is looked up bilinearly, which blurs by up to half a texel.
    """
    height, width, _ = image.shape
    return sample_map(image, equirect_directions(height, width) @ rotation)


def resample_map(picture: Array) -> Array:
    """A file's equirectangular picture (H, W, C) as a map (64, 128, C).

    Every texel is the mean of the picture under the texel's bilinear hat, so that the light that arrives from
    all sides together, and the means over regions larger than a texel, are those of the picture.
    """
    height, width, _ = picture.shape
    rows, columns = _row_means(height), _column_means(width)
    return np.asarray(np.einsum("ih,jw,hwc->ijc", rows, columns, picture, optimize=True))


def pixel_solid_angles(height: int, width: int) -> Array:
    """Solid angles (H, W), steradian, of the pixels of a file's picture."""
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    return np.asarray(np.repeat((edges[:-1] - edges[1:])[:, None] * (2 * np.pi / width), width, axis=1))


def pixel_directions(height: int, width: int) -> Array:
    """Unit directions (H, W, 3) of the pixel centres of a file's picture."""
    theta = np.pi * (np.arange(height) + 0.5)[:, None] / height
    phi = 2 * np.pi * (np.arange(width) + 0.5)[None] / width
    return np.stack(
        [np.sin(theta) * np.sin(phi), np.cos(theta) + 0.0 * phi, -np.sin(theta) * np.cos(phi)], axis=-1
    )


def _row_means(height: int) -> Array:
    """(64, H) weights of the picture's rows in each row of the map; every row of weights sums to 1."""
    theta = np.pi * (np.arange(height * _STEPS) + 0.5) / (height * _STEPS)
    distance = np.abs(theta / np.pi * (MAP_SIZE[0] - 1) - np.arange(MAP_SIZE[0])[:, None])
    weights = np.maximum(1.0 - distance, 0.0) * np.sin(theta)
    return _normalised(weights, height)


def _column_means(width: int) -> Array:
    """(128, W) weights of the picture's columns in each column of the map."""
    at = (np.arange(width * _STEPS) + 0.5) / (width * _STEPS) * MAP_SIZE[1] - 0.5
    distance = np.abs(at - np.arange(MAP_SIZE[1])[:, None])
    return _normalised(np.maximum(1.0 - np.minimum(distance, MAP_SIZE[1] - distance), 0.0), width)


def _normalised(weights: Array, count: int) -> Array:
    summed = weights.reshape(len(weights), count, _STEPS).sum(axis=-1)
    return np.asarray(summed / summed.sum(axis=1, keepdims=True))
