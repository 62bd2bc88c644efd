"""Face alignment: eye centres and the 68 iBUG landmarks, the canonical frame, and the skin mask."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates

from sfsnet_dr.core.config import load_toml
from sfsnet_dr.core.conventions import CHIN_ROW, EYE_DISTANCE, EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT, FACE_SIZE
from sfsnet_dr.core.errors import InputError, check_shape

#: Eye centres ((x, y), (x, y)) in pixels, the one on the image's left first.
Eyes = tuple[tuple[float, float], tuple[float, float]]

#: Top row and half width (pixels) of the ellipse that stands for a face when nothing better is known: from
#: the upper forehead, and 2.2 eye distances wide as the average face is.
_TOP_ROW: Final = 18.0
_HALF_WIDTH: Final = 1.1 * EYE_DISTANCE

#: Above this many photograph pixels a canonical pixel (along x), blocks are averaged first.
_LARGEST_STEP: Final = 8.0


def to_canonical(image: NDArray[np.floating], eyes: Eyes) -> NDArray[np.float32]:
    """Resample a photograph so that its eyes lie where the canonical frame has them.

    A similarity transform (shift, rotation, one scale). Each canonical pixel is the mean of the photograph
    over its square, sampled at least once a photograph pixel, so that nothing aliases when the face is
    large; small faces are interpolated bilinearly. Beyond the photograph it is black, as in
    training (``photo_effects.PhotoOptions.cropped``); see ``canonical_coverage``.

    Args:
        image: linear (H, W, 3). Averaging encoded values would darken edges.
        eyes: centres in pixels, x right and y down from the top left corner, the image's left eye first.

    Returns:
        (128, 128, 3) linear.

    Raises:
        InputError: for another shape, or eyes outside the picture, out of order or less than 4 pixels apart.
    """
    check_shape("image", image, "H W 3")
    return resample_to_canonical(image, eyes)


def resample_to_canonical(image: NDArray[np.floating], eyes: Eyes) -> NDArray[np.float32]:
    """``to_canonical`` for any number of channels: (H, W, C) to (128, 128, C)."""
    sizes = check_shape("image", image, "H W C")
    _check_eyes(eyes, sizes["W"], sizes["H"])
    whole: NDArray[np.float32] = _resample(np.asarray(image, np.float32), eyes, "nearest")
    return whole * canonical_coverage(sizes["H"], sizes["W"], eyes)[..., None]


def canonical_coverage(height: int, width: int, eyes: Eyes) -> NDArray[np.float32]:
    """Share of each canonical pixel that a photograph of this size covers, (128, 128) in [0, 1]."""
    _check_eyes(eyes, width, height)
    x, y = _to_photograph(eyes, [0, 0, FACE_SIZE, FACE_SIZE], [0, FACE_SIZE, 0, FACE_SIZE])
    if x.min() >= 0 and y.min() >= 0 and x.max() <= width and y.max() <= height:
        return np.ones((FACE_SIZE, FACE_SIZE), np.float32)  # all of it, and no need to look closer
    # A ring of zeros, so that the share falls to 0 half a pixel beyond the border and not at once.
    ones = np.pad(np.ones((height, width, 1), np.float32), ((1, 1), (1, 1), (0, 0)))
    (xl, yl), (xr, yr) = eyes
    share = _resample(ones, ((xl + 1, yl + 1), (xr + 1, yr + 1)), "constant")
    return np.ascontiguousarray(share[..., 0])


def face_ellipse_mask() -> NDArray[np.float32]:
    """The mask of a canonical photograph of which only the eyes are known, (128, 128) in [0, 1].

    An upright ellipse from the forehead to the chin of an average frontal face. It does not leave out eyes,
    mouth, glasses or a beard, and a turned or small face will not fill it.
    """
    fine = (np.arange(FACE_SIZE * 8) + 0.5) / 8
    middle = (EYE_IMAGE_LEFT[0] + EYE_IMAGE_RIGHT[0]) / 2
    x = (fine - middle) / _HALF_WIDTH
    y = (fine - (_TOP_ROW + CHIN_ROW) / 2) / ((CHIN_ROW - _TOP_ROW) / 2)
    covered = (x[None, :] ** 2 + y[:, None] ** 2 <= 1).reshape(FACE_SIZE, 8, FACE_SIZE, 8)
    return np.asarray(covered.mean((1, 3)), np.float32)


def side_file(image: Path | str) -> Path:
    """Where the eyes of a photograph are written down: the same name, ending in ``.toml``."""
    return Path(image).with_suffix(".toml")


@dataclass(frozen=True)
class SideFile:
    """What a side file holds: eye centres (x right, y down, pixels), by their side of the image."""

    eye_image_left: tuple[float, float]
    eye_image_right: tuple[float, float]


def read_eyes(path: Path | str) -> Eyes:
    """Read a side file: ``eye_image_left = [x, y]`` and ``eye_image_right = [x, y]``, in pixels.

    Raises:
        InputError: if it is missing, no TOML, or its keys or values are others.
    """
    found = load_toml(SideFile, path)
    return found.eye_image_left, found.eye_image_right


def _check_eyes(eyes: Eyes, width: int, height: int) -> None:
    (xl, yl), (xr, yr) = eyes
    for x, y in eyes:
        if not (0 <= x <= width and 0 <= y <= height):
            raise InputError(
                f"eyes: ({x:g}, {y:g}) found, a point in the {width} x {height} picture is needed"
            )
    if xl >= xr:
        raise InputError(f"eyes: x = {xl:g} before x = {xr:g} found; give the eye on the image's left first")
    if math.hypot(xr - xl, yr - yl) < 4:
        raise InputError(f"eyes: {math.hypot(xr - xl, yr - yl):.1f} pixels apart, at least 4 are needed")


def _resample(image: NDArray[np.float32], eyes: Eyes, beyond: str) -> NDArray[np.float32]:
    step = math.dist(*eyes) / EYE_DISTANCE
    if step > _LARGEST_STEP:
        block = int(step / (_LARGEST_STEP / 2))
        image = _block_means(image, block)
        (xl, yl), (xr, yr) = eyes
        eyes = ((xl / block, yl / block), (xr / block, yr / block))
        step /= block
    samples = max(1, math.ceil(step))
    total = np.zeros((FACE_SIZE, FACE_SIZE, image.shape[2]), np.float64)
    offsets = (np.arange(samples) + 0.5) / samples
    for dy in offsets:
        for dx in offsets:
            x, y = _to_photograph(eyes, np.arange(FACE_SIZE) + dx, np.arange(FACE_SIZE)[:, None] + dy)
            for channel in range(image.shape[2]):
                total[..., channel] += map_coordinates(
                    image[..., channel], [y - 0.5, x - 0.5], order=1, mode=beyond
                )
    return (total / samples**2).astype(np.float32)


def _to_photograph(eyes: Eyes, x: ArrayLike, y: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Canonical coordinates to the photograph's: a similarity is a complex number times another."""
    left, right = (complex(*eye) for eye in eyes)
    factor = (right - left) / (complex(*EYE_IMAGE_RIGHT) - complex(*EYE_IMAGE_LEFT))
    places = left + factor * (np.asarray(x) + 1j * np.asarray(y) - complex(*EYE_IMAGE_LEFT))
    return places.real, places.imag


def _block_means(image: NDArray[np.float32], block: int) -> NDArray[np.float32]:
    """Means of block x block pixels; the border is repeated to fill the last blocks."""
    height, width, channels = image.shape
    padded = np.pad(image, ((0, -height % block), (0, -width % block), (0, 0)), mode="edge")
    blocks = padded.reshape(padded.shape[0] // block, block, padded.shape[1] // block, block, channels)
    means: NDArray[np.float32] = blocks.mean((1, 3))
    return means


Array = npt.NDArray[np.float64]

COUNT: Final = 68
JAW: Final = slice(0, 17)
CHIN: Final = 8
EYE_LEFT: Final = slice(36, 42)
EYE_RIGHT: Final = slice(42, 48)
INNER_LIPS: Final = slice(60, 68)

#: Height of the forehead above the line between the ends of the jaw (ear to ear), as a share of the distance
#: from that line to the chin. An average hairline is at about 0.7; less keeps most fringes out.
_FOREHEAD: Final = 0.45
#: How much an eye's outline grows about its middle, so that lashes and lids are left out with it.
_EYE_GROWTH: Final = 1.3
#: Pixels along each side of the grid on which outlines are filled before its blocks are averaged.
_FINE: Final = 256


def eye_centres(points: Array) -> Eyes:
    """Centres of both eyes, each the mean of its six landmarks, in the landmarks' own pixels.

    Args:
        points: (68, 2), x right, y down.

    Raises:
        InputError: for another shape or landmarks that are not finite.
    """
    check_shape("landmarks", points, f"{COUNT} 2")
    if not np.isfinite(points).all():
        raise InputError("landmarks: NaN or inf found, finite pixels are needed")
    (xl, yl), (xr, yr) = points[EYE_LEFT].mean(0), points[EYE_RIGHT].mean(0)
    return (float(xl), float(yl)), (float(xr), float(yr))


def canonical_landmarks(points: Array, eyes: Eyes | None = None) -> Array:
    """Landmarks (68, 2) of a photograph in the canonical frame of 128 x 128.

    Args:
        points: in the photograph's pixels.
        eyes: what lies at the frame's eyes, in the same pixels; the landmarks' own eyes if left out.
    """
    left, right = (complex(*eye) for eye in (eyes or eye_centres(points)))
    factor = (complex(*EYE_IMAGE_RIGHT) - complex(*EYE_IMAGE_LEFT)) / (right - left)
    places = complex(*EYE_IMAGE_LEFT) + factor * (points[:, 0] + 1j * points[:, 1] - left)
    return np.stack([places.real, places.imag], -1)


def skin_mask(points: Array, size: int = FACE_SIZE) -> npt.NDArray[np.float32]:
    """The face's skin by its landmarks: inside jaw and forehead, outside the eyes and the open mouth.

    The forehead, of which there are no landmarks, is half an ellipse over the line between the ends of the
    jaw. Hair, glasses, beards and hands are not left out.

    Args:
        points: (68, 2) in the canonical frame.
        size: width and height of the mask, a divisor of 256.

    Returns:
        Share of each pixel that is skin, (size, size) in [0, 1].
    """
    if _FINE % size:
        raise InputError(f"size: {size} found, a divisor of {_FINE} is needed")
    skin = _filled(np.concatenate([points[JAW], _forehead(points)]))
    for eye in (points[EYE_LEFT], points[EYE_RIGHT]):
        skin &= ~_filled(eye.mean(0) + _EYE_GROWTH * (eye - eye.mean(0)))
    skin &= ~_filled(points[INNER_LIPS])
    block = _FINE // size
    return np.asarray(skin.reshape(size, block, size, block).mean((1, 3)), np.float32)


def _forehead(points: Array) -> Array:
    """Half an ellipse from the jaw's end on the image's right over the top to the one on its left."""
    left, right = points[JAW][0], points[JAW][-1]
    middle, side = (left + right) / 2, (right - left) / 2
    up = middle - points[CHIN]
    angle = np.linspace(0, np.pi, 24)[:, None]
    return np.asarray(middle + side * np.cos(angle) + _FOREHEAD * up * np.sin(angle))


def _filled(outline: Array) -> npt.NDArray[np.bool_]:
    """Which points of the fine grid lie inside an outline (N, 2) in canonical pixels."""
    from skimage.draw import polygon2mask

    # Centres of the fine pixels are where polygon2mask has whole numbers, rows first.
    places = outline[:, ::-1] * (_FINE / FACE_SIZE) - 0.5
    inside: npt.NDArray[np.bool_] = polygon2mask((_FINE, _FINE), places)  # type: ignore[no-untyped-call]
    return inside
