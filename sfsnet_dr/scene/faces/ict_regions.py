"""Which part of the ICT FaceKit head each vertex belongs to, from its vertex ranges and its 68 landmarks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import interpolate, spatial

from sfsnet_dr.scene.faces.regions import (
    RegionWeights,
    distance_to,
    scalp_weight,
    signed_distance,
    smoothstep,
)

Array = npt.NDArray[np.float64]

#: First vertex of each part and one past the last (FaceKit's own order).
FACE = range(0, 9409)
HEAD = range(9409, 11248)
MOUTH_SOCKET = range(11248, 13294)
EYE_SOCKETS = range(13294, 14062)
GUMS_AND_TONGUE = range(14062, 17039)
TEETH = range(17039, 21451)
#: The outer shell (sclera and cornea) of each eye, image right and image left. The shells inside, with the
#: irises, are left out: the outer one is opaque here and carries the painted iris.
EYEBALLS = (range(21451, 22221), range(23021, 23791))
_BODY_END = EYE_SOCKETS.stop  # one connected surface of quads

#: Vertices of the 68 landmarks (iBUG 300-W order), as FaceKit documents them.
LANDMARKS = np.array(
    [
        *(1225, 1888, 1052, 367, 1719, 1722, 2199, 1447, 966, 3661, 4390, 3927, 3924, 2608, 3272, 4088, 3443),
        *(268, 493, 1914, 2044, 1401, 3615, 4240, 4114, 2734, 2509),
        *(978, 4527, 4942, 4857, 1140, 2075, 1147, 4269, 3360),
        *(1507, 1542, 1537, 1528, 1518, 1511, 3742, 3751, 3756, 3721, 3725, 3732),
        *(5708, 5695, 2081, 0, 4275, 6200, 6213, 6346, 6461, 5518, 5957, 5841),
        *(5702, 5711, 5533, 6216, 6207, 6470, 5517, 5966),
    ]
)
JAW = slice(0, 17)
_BROWS, _MOUTH = (slice(17, 22), slice(22, 27)), slice(48, 60)

_EAR_CENTRE, _EAR_SIZE = np.array([0.47, 0.57]), np.array([0.085, 0.115])  # texture, |u - 1/2| and v
_FACE_SIDE = 0.37  # texture, |u - 1/2|: where the cheek ends before the ear
_FOREHEAD_TOP = 7.95  # decimetres
_BROW_DROP = 0.03  # decimetres: the landmarks run along the brows' upper edge
_TONGUE_AWAY = 0.06  # decimetres from the nearest tooth: what is closer is gum


@dataclass(frozen=True)
class KeptMesh:
    """The part of the model that is used, in the common frame.

    Attributes:
        kept: (V,) FaceKit's vertex numbers, rising.
        neutral: (V, 3) decimetres.
        uv: (V, 2) texture coordinates; where the seam gives a vertex two, those of the face's own island.
        quads: (Q, 4) faces of four corners; the first ones belong to the body.
        triangles: (T, 3) the others: in eyes, teeth and gums.
    """

    kept: npt.NDArray[np.int64]
    neutral: Array
    uv: Array
    quads: npt.NDArray[np.uint32]
    triangles: npt.NDArray[np.uint32]

    @property
    def body_count(self) -> int:
        """Number of vertices of the skin with the insides of mouth and eye sockets; they come first."""
        return _BODY_END

    def part(self, *ranges: range) -> npt.NDArray[np.bool_]:
        """(V,) whether a vertex lies in one of FaceKit's ranges."""
        return np.isin(self.kept, np.concatenate([np.asarray(r) for r in ranges]))


def kept_vertices() -> npt.NDArray[np.int64]:
    """FaceKit's vertices that are used: lacrimal fluid, eye blend, occlusion and lash shells are left out."""
    solid = [FACE, HEAD, MOUTH_SOCKET, EYE_SOCKETS, GUMS_AND_TONGUE, TEETH, *EYEBALLS]
    return np.concatenate([np.asarray(r) for r in solid]).astype(np.int64)


def ict_regions(mesh: KeptMesh) -> RegionWeights:
    """Lay the regions out on the unrefined neutral head."""
    position = mesh.neutral
    face_range = mesh.part(FACE)
    eyeball = mesh.part(*EYEBALLS).astype(np.float64)
    mouth, tongue = _mouth_parts(mesh)
    lips = _lips(mesh) * face_range
    ear = _ears(mesh)
    skin = mesh.part(FACE, HEAD) * (1.0 - ear)
    return RegionWeights(
        neutral=position,
        face=_face(mesh) * face_range * (1.0 - ear),
        lips=lips,
        eyelid=_eyelids(mesh) * face_range,
        ear=ear,
        mouth_inside=mouth,
        brow=_brows(position) * face_range,
        scalp=scalp_weight(position) * skin,
        eyeball=eyeball,
        teeth=mesh.part(TEETH).astype(np.float64),
        tongue=tongue,
        gaze_angle=_gaze_angles(mesh),
    )


def _face(mesh: KeptMesh) -> Array:
    """1 above the jaw's outline, in front of the ears and below the crown, in texture space."""
    side = np.abs(mesh.uv[:, 0] - 0.5)
    jaw = mesh.uv[LANDMARKS[JAW]]
    order = np.argsort(np.abs(jaw[:9, 0] - 0.5))
    line = np.interp(side, np.abs(jaw[:9, 0] - 0.5)[order], jaw[:9, 1][order])
    above = smoothstep(-0.01, 0.01, mesh.uv[:, 1] - line)
    return (
        above
        * smoothstep(_FACE_SIDE + 0.01, _FACE_SIDE - 0.01, side)
        * (smoothstep(_FOREHEAD_TOP + 0.05, _FOREHEAD_TOP - 0.05, mesh.neutral[:, 1]))
    )


def _lips(mesh: KeptMesh) -> Array:
    """Inside the closed curve through the twelve outer landmarks, in texture space."""
    outline = mesh.uv[LANDMARKS[_MOUTH]]
    return smoothstep(-0.006, 0.006, signed_distance(mesh.uv, _closed_curve(outline)))


def _ears(mesh: KeptMesh) -> Array:
    """An oval in texture space, and the back of the ear close behind it."""
    place = np.stack([np.abs(mesh.uv[:, 0] - 0.5), mesh.uv[:, 1]], axis=1)
    radius = np.linalg.norm((place - _EAR_CENTRE) / _EAR_SIZE, axis=1)
    front = smoothstep(1.05, 0.95, radius) * mesh.part(FACE)
    away, _ = spatial.cKDTree(mesh.neutral[front > 0.5]).query(mesh.neutral)
    side = np.abs(mesh.neutral[:, 0])
    back = smoothstep(0.16, 0.10, away) * smoothstep(0.69, 0.72, side) * mesh.part(HEAD)
    return np.maximum(front, back)


def _eyelids(mesh: KeptMesh) -> Array:
    """Skin near the rim of the lids: 4 mm above, 2 mm below."""
    sockets = mesh.part(EYE_SOCKETS)
    on_socket = sockets[mesh.quads]
    rim = np.unique(mesh.quads[on_socket.any(axis=1) & ~on_socket.all(axis=1)])
    away, nearest = spatial.cKDTree(mesh.neutral[rim]).query(mesh.neutral)
    above = mesh.neutral[rim][nearest][:, 1] > 7.26
    return np.where(above, smoothstep(0.045, 0.025, away), smoothstep(0.03, 0.015, away))


def _brows(position: Array) -> Array:
    """Bands along the brow landmarks, thinner outside, with soft edges."""
    weight = np.zeros(len(position))
    for part in _BROWS:
        points = position[LANDMARKS[part]][:, :2] - (0.0, _BROW_DROP)
        path = points[np.argsort(np.abs(points[:, 0]))]
        away, along = distance_to(position[:, :2], path)
        thickness = 0.042 * (1.0 - 0.5 * along)
        weight = np.maximum(weight, smoothstep(1.35, 0.65, away / thickness))
    return weight * (position[:, 2] > 0.9)


def _mouth_parts(mesh: KeptMesh) -> tuple[Array, Array]:
    """Weights of the moist inside, that of the eyes' corners included, and of the tongue."""
    soft = mesh.part(GUMS_AND_TONGUE)
    away, _ = spatial.cKDTree(mesh.neutral[mesh.part(TEETH)]).query(mesh.neutral)
    tongue = soft & (away > _TONGUE_AWAY) & (mesh.neutral[:, 1] < 6.63)
    inside_weight = mesh.part(MOUTH_SOCKET, EYE_SOCKETS) | (soft & ~tongue)
    return inside_weight.astype(np.float64), tongue.astype(np.float64)


def _gaze_angles(mesh: KeptMesh) -> Array:
    """Degrees from the middle of the cornea, the part of the shell that bulges most."""
    angle = np.full(len(mesh.neutral), 180.0)
    for eye, centre in zip(EYEBALLS, eyeball_centres(mesh), strict=True):
        here = mesh.part(eye)
        direction = mesh.neutral[here] - centre
        radius = np.linalg.norm(direction, axis=1)
        unit = direction / radius[:, None]
        bulge = np.maximum(radius - np.median(radius), 0.0) * (unit[:, 2] > 0.5)
        axis = bulge @ unit
        axis /= np.linalg.norm(axis)
        angle[here] = np.degrees(np.arccos(np.clip(unit @ axis, -1.0, 1.0)))
    return angle


def eyeball_centres(mesh: KeptMesh) -> Array:
    """(2, 3) centres of the spheres of ``EYEBALLS``: the cornea's bulge in front does not count."""
    centres = []
    for eye in EYEBALLS:
        points = mesh.neutral[mesh.part(eye)]
        low, high = points.min(axis=0), points.max(axis=0)
        middle = (low + high) / 2
        radius = (high - low)[:2].mean() / 2
        centres.append([middle[0], middle[1], low[2] + radius])
    return np.array(centres)


def _closed_curve(points: Array) -> Array:
    """(120, 2) points of a smooth closed curve through given ones."""
    closed = np.vstack([points, points[:1]])
    curve, _ = interpolate.splprep(closed.T, s=0.0, per=True)
    return np.stack(interpolate.splev(np.linspace(0.0, 1.0, 120, endpoint=False), curve), axis=1)
