"""Regions of a Basel-style face, drawn on its front from a handful of landmarks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.scene.face_model import EYE_CENTRES, EYE_SURFACE
from sfsnet_dr.scene.head_regions import IRIS_DEGREES, RegionWeights, scalp_weight, smoothstep
from sfsnet_dr.scene.outlines import distance_to

Array = npt.NDArray[np.float64]
Points = dict[str, Array]

_NEEDED = (
    *(f"{side}.eye.corner_{end}" for side in ("right", "left") for end in ("outer", "inner")),
    *("right.lips.corner", "left.lips.corner", "center.lips.upper.outer", "center.lips.lower.outer"),
    *("center.nose.tip", "center.chin.tip"),
)

_OPENING = 0.36  # height of the eye's opening by its width
_RADIUS = 0.145  # decimetres: eyeball that the painted iris is measured on
_FRONT = 0.5  # decimetres behind the corners of the eyes, where lips and lids can no longer lie
_EAR_SIDE, _EAR_BEHIND = 0.70, 0.62  # decimetres: ears stand out beside this and lie behind that depth


@dataclass(frozen=True)
class Frame:
    """A similarity transform into the common frame: scale, then shift.

    Attributes:
        scale: decimetres a unit of the file.
        shift: (3,) decimetres.
        eyes: (2, 3) eyeball centres of the mean, image left first, in the common frame.
    """

    scale: float
    shift: Array
    eyes: Array

    def apply(self, points: Array) -> Array:
        """(..., 3) points of the file in the common frame."""
        return np.asarray(points * self.scale + self.shift)


def to_common_frame(landmarks: Points, where: str) -> Frame:
    """The transform that brings the middles of the eyes' openings to Anny's.

    Raises:
        BadInput: naming the landmarks that are missing, or for a mesh that does not stand upright.
    """
    missing = [name for name in _NEEDED if name not in landmarks]
    if missing:
        raise BadInput(f"{where}: landmarks {', '.join(missing)} are missing in metadata/landmarks/json")
    middles = np.stack([_middle(landmarks, side) for side in ("right", "left")])  # the right one: image left
    across = middles[1] - middles[0]
    below = landmarks["center.chin.tip"][1] < landmarks["center.nose.tip"][1] < middles[:, 1].mean()
    if across[0] <= 0 or not below or landmarks["center.nose.tip"][2] < middles[:, 2].max():
        raise BadInput(f"{where}: the landmarks do not stand upright with x to the left eye and z forward")
    target = EYE_CENTRES + EYE_SURFACE
    scale = float(np.ptp(target[:, 0]) / np.linalg.norm(across))
    shift = target.mean(axis=0) - scale * middles.mean(axis=0)
    return Frame(scale, shift, middles * scale + shift - EYE_SURFACE)


def basel_regions(neutral: Array, landmarks: Points, where: str) -> RegionWeights:
    """Lay the regions out.

    Args:
        neutral: (V, 3) the mean in the common frame.
        landmarks: in the common frame.
        where: the file, for messages.

    Raises:
        BadInput: for a mesh that has no vertex in eyes or lips.
    """
    nothing = np.zeros(len(neutral))
    front = (neutral[:, 2] > landmarks["right.eye.corner_outer"][2] - _FRONT).astype(np.float64)
    eyeball, eyelid, gaze = _eyes(neutral, landmarks)
    ear = smoothstep(_EAR_SIDE, _EAR_SIDE + 0.03, np.abs(neutral[:, 0])) * (neutral[:, 2] < _EAR_BEHIND)
    chin = landmarks["center.chin.tip"][1]
    above_chin = smoothstep(chin - 0.10, chin - 0.04, neutral[:, 1])
    weights = RegionWeights(
        neutral=neutral,
        face=above_chin * smoothstep(0.66, 0.70, neutral[:, 2]) * smoothstep(8.0, 7.9, neutral[:, 1]),
        lips=_lips(neutral, landmarks) * front,
        eyelid=eyelid * front,
        ear=ear,
        mouth_inside=nothing,
        brow=_brows(neutral, landmarks) * front,
        scalp=scalp_weight(neutral) * (1.0 - ear),
        eyeball=eyeball * front,
        teeth=nothing,
        tongue=nothing,
        gaze_angle=np.where(eyeball * front > 0.5, gaze, 180.0),
    )
    for part in ("eyeball", "lips"):
        if not (getattr(weights, part) > 0.5).any():
            raise BadInput(f"{where}: no vertex of the mean lies in the {part}; are landmarks and mesh one?")
    return weights


def _middle(landmarks: Points, side: str) -> Array:
    return (landmarks[f"{side}.eye.corner_outer"] + landmarks[f"{side}.eye.corner_inner"]) / 2


def _eyes(neutral: Array, landmarks: Points) -> tuple[Array, Array, Array]:
    """Weights of the openings (almonds between the corners), of the lids about them, and the gaze angle."""
    opening, lid, gaze = np.zeros(len(neutral)), np.zeros(len(neutral)), np.full(len(neutral), 180.0)
    for side in ("right", "left"):
        middle = _middle(landmarks, side)
        half = abs(landmarks[f"{side}.eye.corner_outer"][0] - middle[0])
        along = (neutral[:, 0] - middle[0]) / half
        height = _OPENING * half * np.maximum(1.0 - along**2, 0.0)
        past = np.abs(neutral[:, 1] - middle[1]) - height
        opening = np.maximum(opening, smoothstep(0.01, -0.01, past) * (np.abs(along) < 1.0))
        near = smoothstep(0.05, 0.03, past) * (np.abs(along) < 1.2)
        lid = np.maximum(lid, near)
        away = np.linalg.norm(neutral[:, :2] - middle[:2], axis=1)
        gaze = np.minimum(gaze, np.degrees(np.arcsin(np.clip(away / _RADIUS, 0.0, 1.0))))
    return opening, lid * (1.0 - opening), np.maximum(gaze, 0.01 * IRIS_DEGREES)


def _lips(neutral: Array, landmarks: Points) -> Array:
    """Between two parabolas through the corners and the middles of the lips' borders."""
    right, left = landmarks["right.lips.corner"], landmarks["left.lips.corner"]
    middle, half = (right + left) / 2, (left[0] - right[0]) / 2
    along = (neutral[:, 0] - middle[0]) / half
    bow = np.maximum(1.0 - along**2, 0.0)
    top = middle[1] + (landmarks["center.lips.upper.outer"][1] - middle[1]) * bow
    bottom = middle[1] + (landmarks["center.lips.lower.outer"][1] - middle[1]) * bow
    within = np.minimum(top - neutral[:, 1], neutral[:, 1] - bottom)
    return np.asarray(smoothstep(-0.01, 0.01, within) * (np.abs(along) < 1.0))


def _brows(neutral: Array, landmarks: Points) -> Array:
    """Bands over the eyes' corners, arched like Anny's."""
    weight = np.zeros(len(neutral))
    for side in ("right", "left"):
        inner, outer = landmarks[f"{side}.eye.corner_inner"], landmarks[f"{side}.eye.corner_outer"]
        step = outer - inner
        places = np.array([[-0.15, 0.215], [0.3, 0.245], [0.7, 0.255], [1.25, 0.20]])
        path = np.stack([inner[0] + places[:, 0] * step[0], inner[1] + places[:, 1]], axis=1)
        away, along = distance_to(neutral[:, :2], path)
        weight = np.maximum(weight, smoothstep(1.35, 0.65, away / (0.042 * (1.0 - 0.5 * along))))
    return weight
