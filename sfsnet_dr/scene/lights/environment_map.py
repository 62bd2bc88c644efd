"""Environment maps from files, their suns and lamps taken out as directional lights.

A lamp much smaller than the blur of order 4 (about 40 degrees) would be smeared over the sky by truncation,
and its hard shadows with it. So what is hot and compact is split off:

    hot      luminance above 20 times the map's mean without the brightest hundredth of the solid angle;
    compact  a connected group of hot pixels within 5 degrees (root mean square) of its own middle;
    strong   its excess over the threshold is at least 3 % of all light; at most the 4 strongest are taken.

Only the excess leaves the map: pixels of a group stay at the threshold. The rest of the map is a sky, windows
and walls, for which ``Light.coefficients`` of order 4 is honest.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.image_io import read_image
from sfsnet_dr.scene.lights.equirect import pixel_directions, pixel_solid_angles, resample_map
from sfsnet_dr.scene.lights.light import DirectionalLight, Light

Array = npt.NDArray[np.float64]

#: The rule of the module's description.
HOT: Final = 20.0
COMPACT: Final = 5.0
STRONG: Final = 0.03
MOST: Final = 4

_SUFFIXES = (".exr", ".hdr")
_LEAST_HEIGHT = 16


def list_maps(folder: Path | str) -> tuple[Path, ...]:
    """The environment maps of a folder, ``.exr`` and ``.hdr``, by name.

    Raises:
        InputError: if there is no such folder or no map in it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give one that holds environment maps (.exr, .hdr)")
    found = tuple(sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES))
    if not found:
        raise InputError(f"{folder}: no environment map (.exr, .hdr) found in it")
    return found


def load_environment(path: Path | str) -> Light:
    """Read an environment map.

    Args:
        path: equirectangular picture, twice as wide as high, zenith on top, of float samples (EXR, HDR). Its
            middle becomes +z.

    Returns:
        Its light, named after the file, in the file's units.

    Raises:
        InputError: for a missing or damaged file, 8-bit pictures, another shape, NaN, inf, negative radiance,
            or a black map.
    """
    path = Path(path)
    try:
        changed = path.stat().st_mtime_ns
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give an environment map") from error
    return _load(path, changed)


@lru_cache(maxsize=64)
def _load(path: Path, changed: int) -> Light:
    image = read_image(path, channels=3)
    height, width, _ = image.pixels.shape
    if image.was_srgb:
        raise InputError(f"{path}: 8-bit picture found, an environment map needs float samples (EXR, HDR)")
    if width != 2 * height or height < _LEAST_HEIGHT:
        raise InputError(
            f"{path}: {width} x {height} pixels found, an environment map is twice as wide as high and at "
            f"least {_LEAST_HEIGHT} high"
        )
    pixels = image.pixels.astype(np.float64)
    if pixels.min() < 0:
        raise InputError(f"{path}: negative radiance {pixels.min():g} found, values from 0 on allowed")
    if not pixels.any():
        raise InputError(f"{path}: black from end to end; an environment map must hold light")
    rest, lamps = split_lamps(pixels)
    environment = resample_map(rest)
    environment.setflags(write=False)  # it is kept and shared
    return Light(path.stem, environment, lamps)


def split_lamps(picture: Array) -> tuple[Array, tuple[DirectionalLight, ...]]:
    """Take suns and lamps out of a picture by the module's rule.

    Args:
        picture: (H, W, 3) radiance as files have it.

    Returns:
        The picture without their excess, and the lights, strongest first. Together they hold all the light.
    """
    height, width, _ = picture.shape
    luminance, angles = picture @ LUMINANCE, pixel_solid_angles(height, width)
    total = float((luminance * angles).sum())
    threshold = HOT * _ordinary(luminance, angles)
    excess = picture * np.maximum(1.0 - threshold / np.maximum(luminance, 1e-300), 0.0)[..., None]
    directions = pixel_directions(height, width)
    found = []
    for group in _groups(luminance > threshold):
        power = excess[group] * angles[group][:, None]
        share = power @ LUMINANCE
        middle = share @ directions[group]
        spread = np.degrees(_spread(directions[group], share, middle))
        if share.sum() >= STRONG * total and spread <= COMPACT:
            found.append((float(share.sum()), group, middle / np.linalg.norm(middle), power.sum(axis=0)))
    found.sort(key=lambda item: -item[0])
    rest = picture.copy()
    for _, group, _, _ in found[:MOST]:
        rest[group] -= excess[group]
    return rest, tuple((direction, power) for _, _, direction, power in found[:MOST])


def _ordinary(luminance: Array, angles: Array) -> float:
    """Mean luminance without the brightest hundredth of the sphere, in which suns and lamps lie."""
    order = np.argsort(luminance, axis=None)
    below = np.cumsum(angles.ravel()[order]) <= 0.99 * angles.sum()
    kept = order[below]
    return float(np.average(luminance.ravel()[kept], weights=angles.ravel()[kept]))


def _groups(hot: npt.NDArray[np.bool_]) -> list[tuple[npt.NDArray[np.intp], ...]]:
    """Connected groups of true pixels (diagonals count), across the seam at the sides too."""
    labels, count = ndimage.label(hot, structure=np.ones((3, 3)))
    names = np.arange(count + 1)
    for row in range(len(hot)):
        for other in range(max(row - 1, 0), min(row + 2, len(hot))):
            left, right = names[labels[row, 0]], names[labels[other, -1]]
            if left and right:
                names[names == right] = left
    merged = names[labels]
    return [np.nonzero(merged == name) for name in np.unique(merged) if name]


def _spread(directions: Array, share: Array, middle: Array) -> float:
    """Root mean square angle, radian, from the middle."""
    cosine = np.clip(directions @ (middle / np.linalg.norm(middle)), -1.0, 1.0)
    return float(np.sqrt((share @ np.arccos(cosine) ** 2) / share.sum()))
