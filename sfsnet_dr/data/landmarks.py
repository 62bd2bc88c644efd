"""The 68 landmarks of a face (iBUG 300-W order): where its eyes are, and which pixels are its skin."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.checks import BadInput, check_shape
from sfsnet_dr.base.conventions import EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT, FACE_SIZE
from sfsnet_dr.data.photograph import Eyes

Array = npt.NDArray[np.float64]

COUNT: Final = 68
JAW: Final = slice(0, 17)
CHIN: Final = 8
EYE_LEFT: Final = slice(36, 42)
EYE_RIGHT: Final = slice(42, 48)
INNER_LIPS: Final = slice(60, 68)

#: Height of the forehead above the line between the ends of the jaw (ear to ear), as a share of the distance
#: from that line to the chin. An average hairline is at about .7; less keeps most fringes out.
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
        BadInput: for another shape or landmarks that are not finite.
    """
    check_shape("landmarks", points, f"{COUNT} 2")
    if not np.isfinite(points).all():
        raise BadInput("landmarks: NaN or inf found, finite pixels are needed")
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
        raise BadInput(f"size: {size} found, a divisor of {_FINE} is needed")
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
