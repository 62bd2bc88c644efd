"""Where on the head cheeks, beard, hairline and creases lie: soft fields that all persons share.

They are laid out once per topology, on the neutral head. Heights are first warped so that chin, mouth, nose,
eyes and brows of any face model stand where Anny's do; positions below are in that frame (decimetres, eyes at
y = 7.28, the side is |x|).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sfsnet_dr.scene.faces.per_head_cache import cached_per_head
from sfsnet_dr.scene.faces.regions import RegionWeights, smoothstep

Array = NDArray[np.float64]
Field = NDArray[np.float64]

#: Heights of chin, mouth, base and tip of the nose, eyes and brows of the Anny head.
_ANNY_HEIGHTS = np.array([6.161, 6.616, 6.765, 6.922, 7.284, 7.493])
_ANNY_MOUTH_SIDE = 0.255


@dataclass(frozen=True, eq=False)
class FaceZones:
    """Fields of (V,) values in [0, 1] unless said otherwise.

    Attributes:
        place: (V, 3) side |x|, height and depth in Anny's frame.
        signed_side: (V,) the side with its sign, positive on the image right.
        front: the front of the head, where a camera sees it.
        cheek, nose, chin, forehead, perioral: soft spots.
        under_eye, socket: the shadow under an eye; the upper lid up to the brow.
        moustache, jaw: where a beard grows: the upper lip; chin, jaw, sideburns and upper neck.
        mouth_corner: where lips and cheek fold against each other, too tight for relief.
        lash: rim of the lids, 1 on the upper one.
        hairline: signed decimetres inside the hair of the scalp (negative on the face), without recession.
        crown: top of the head, where baldness begins.
        brow_middle: height of the brows' middle line at each vertex's side, decimetres.
    """

    place: Array
    signed_side: Array
    front: Field
    cheek: Field
    nose: Field
    chin: Field
    forehead: Field
    perioral: Field
    under_eye: Field
    socket: Field
    moustache: Field
    jaw: Field
    mouth_corner: Field
    lash: Field
    hairline: Field
    crown: Field
    brow_middle: Field


@cached_per_head
def face_zones(weights: RegionWeights) -> FaceZones:
    """The zones of a head."""
    place = _in_anny_frame(weights)
    side, height, depth = place.T
    front = smoothstep(0.55, 0.8, depth)
    outside = (1.0 - weights.ear) * (1.0 - weights.mouth_inside) * (1.0 - weights.eyeball)
    skin = outside * (1.0 - weights.lips) * (1.0 - weights.teeth) * (1.0 - weights.tongue)
    return FaceZones(
        place=place,
        signed_side=np.copysign(side, weights.neutral[:, 0]),
        front=front,
        cheek=front * _spot(place, 0.44, 6.88, 0.20, 0.20),
        nose=front * _spot(place, 0.0, 6.91, 0.17, 0.14),
        chin=front * _spot(place, 0.0, 6.30, 0.22, 0.14),
        forehead=front * smoothstep(7.50, 7.65, height) * smoothstep(0.72, 0.45, side),
        perioral=front * _spot(place, 0.0, 6.62, 0.36, 0.20) * (1.0 - weights.lips),
        under_eye=front * _spot(place, 0.29, 7.135, 0.15, 0.055),
        socket=front * _spot(place, 0.31, 7.37, 0.17, 0.07),
        moustache=skin * _moustache(place),
        jaw=skin * _jaw(place),
        mouth_corner=_mouth_corner(weights, place),
        lash=_lash(weights, place),
        hairline=_hairline(place) - 0.5 * weights.ear,
        crown=smoothstep(7.75, 8.05, height) * smoothstep(1.45, 1.1, depth),
        brow_middle=_brow_middle(weights, place),
    )


def _in_anny_frame(weights: RegionWeights) -> Array:
    """(V, 3) side, height and depth with this head's mouth width and heights made Anny's."""
    side, height, depth = np.abs(weights.neutral[:, 0]), weights.neutral[:, 1], weights.neutral[:, 2]
    heights = _heights(weights)
    warped = np.interp(height, heights, _ANNY_HEIGHTS)
    warped += np.minimum(height - heights[0], 0.0) + np.maximum(height - heights[-1], 0.0)
    width = side[weights.lips > 0.5].max(initial=0.0) or _ANNY_MOUTH_SIDE
    scale = np.interp(warped, _ANNY_HEIGHTS[[1, 4]], [_ANNY_MOUTH_SIDE / width, 1.0])
    return np.stack([side * scale, warped, depth], axis=1)


def _heights(weights: RegionWeights) -> Array:
    """Chin, mouth, base and tip of the nose, eyes and brows of this head, rising.

    The eyes stand at Anny's height in the common frame of all face models. A mesh too coarse to show its nose
    on the middle line keeps its heights: these are then Anny's.
    """
    side, height, depth = np.abs(weights.neutral[:, 0]), weights.neutral[:, 1], weights.neutral[:, 2]
    eye, lips = _ANNY_HEIGHTS[4], weights.lips > 0.5
    middle = (weights.face > 0.5) & (weights.mouth_inside < 0.5) & (side < 0.008)  # between the nostrils
    nose = middle & (height > _ANNY_HEIGHTS[1] + 0.08) & (height < eye)
    if not (nose.any() and lips.any() and weights.brow.any()):
        return _ANNY_HEIGHTS
    mouth, brow = height[lips].mean(), np.average(height, weights=weights.brow)
    tip = height[nose][depth[nose].argmax()]
    under = nose & (height < tip - 0.05)
    base = height[under][depth[under].argmin()] if under.any() else mouth
    heights = np.array([height[middle].min(), mouth, base, tip, eye, brow])
    return heights if (np.diff(heights) > 0.0).all() else _ANNY_HEIGHTS


def _spot(place: Array, side: float, height: float, width: float, tall: float) -> Field:
    """A Gaussian blob on the front of the face, symmetric left and right."""
    return np.asarray(np.exp(-(((place[:, 0] - side) / width) ** 2) - ((place[:, 1] - height) / tall) ** 2))


def _moustache(place: Array) -> Field:
    """Between nose and upper lip, and down past the corners of the mouth."""
    side, height, depth = place.T
    top = np.interp(side, [0.0, 0.10, 0.18, 0.26, 0.34], [6.775, 6.785, 6.795, 6.74, 6.66])
    bottom = np.interp(side, [0.0, 0.24, 0.28, 0.34], [6.60, 6.60, 6.53, 6.50])
    band = smoothstep(top + 0.015, top - 0.035, height) * smoothstep(bottom - 0.04, bottom + 0.02, height)
    return np.asarray(band * smoothstep(0.37, 0.29, side) * smoothstep(1.1, 1.25, depth))


def _jaw(place: Array) -> Field:
    """Chin, jaw and sideburns below the cheek line, fading out on the neck."""
    side, height, depth = place.T
    line = np.interp(
        side, [0.0, 0.24, 0.30, 0.45, 0.56, 0.64, 0.69, 0.72], [6.55, 6.54, 6.60, 6.66, 6.78, 6.93, 7.12, 7.3]
    )
    below = smoothstep(line + 0.06, line - 0.05, height)
    neck = smoothstep(5.82, 6.12, height + 0.25 * (depth - 1.0))
    behind = smoothstep(0.54, 0.66, depth + 0.5 * np.maximum(6.6 - height, 0.0))
    return np.asarray(below * neck * behind * (depth > 0.4))


def _mouth_corner(weights: RegionWeights, place: Array) -> Field:
    lips = place[weights.lips > 0.5]
    if not len(lips):
        return np.zeros(len(place))
    corner = lips[lips[:, 0] > 0.94 * lips[:, 0].max()].mean(axis=0)
    return _spot(place, float(corner[0]), float(corner[1]), 0.06, 0.05)


def _lash(weights: RegionWeights, place: Array) -> Field:
    """The rims of the lids, found by their closeness to the eyeball; the upper one is the darker."""
    lash = np.zeros(len(place))
    eyeball = weights.neutral[weights.eyeball > 0.5]
    near = np.flatnonzero((weights.eyelid > 0.0) & (weights.eyeball < 0.5))
    if not (len(eyeball) and len(near)):
        return lash
    distance, _ = cKDTree(eyeball).query(weights.neutral[near])
    upper = 0.35 + 0.65 * smoothstep(7.265, 7.30, place[near, 1])
    lash[near] = smoothstep(0.05, 0.02, distance) * upper
    return lash * smoothstep(0.12, 0.20, place[:, 0]) * (1.0 - weights.eyeball)


def _hairline(place: Array) -> Field:
    """Signed distance inside the hair: over the forehead by height, at temples and sideburns by depth."""
    side, height, depth = place.T
    over = height - np.interp(side, [0.0, 0.25, 0.42, 0.55, 0.8], [7.87, 7.88, 7.91, 7.88, 7.78])
    edge_height = [6.30, 6.42, 6.85, 7.00, 7.15, 7.30, 7.45, 7.60, 7.75, 7.90, 8.2]
    edge_depth = [-0.3, 0.22, 0.38, 0.62, 0.70, 0.73, 0.78, 0.86, 0.93, 0.96, 1.0]
    beside = np.interp(height, edge_height, edge_depth) - depth
    return np.asarray(np.maximum(np.minimum(over, 0.5), np.minimum(beside, 0.5)))


def _brow_middle(weights: RegionWeights, place: Array) -> Field:
    """A parabola through the brow weights, the same for both sides."""
    brow = weights.brow > 0.3
    if np.count_nonzero(brow) < 6:
        return np.full(len(place), _ANNY_HEIGHTS[-1])
    fit = np.polyfit(place[brow, 0], place[brow, 1], 2, w=np.sqrt(weights.brow[brow]))
    return np.asarray(np.polyval(fit, np.clip(place[:, 0], 0.1, 0.6)))
