"""Basel-style morphable models (BFM 2017, BFM 2019): files, regions and heads.

The files cannot be passed on, so that users bring their own. Their surface is closed: no eyeballs, no mouth;
eyes are painted on it. Regions come from the landmarks that the files carry in ``metadata/landmarks/json``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.faces.model import (
    EYE_CENTRES,
    EYE_SURFACE,
    HeadShape,
    Stream,
    Streams,
    digest_of,
    find_landmarks,
)
from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.faces.regions import IRIS_DEGREES, RegionWeights, distance_to, scalp_weight, smoothstep
from sfsnet_dr.scene.mesh import vertex_normals
from sfsnet_dr.scene.spec import HeadSpec

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
        InputError: naming the landmarks that are missing, or for a mesh that does not stand upright.
    """
    missing = [name for name in _NEEDED if name not in landmarks]
    if missing:
        raise InputError(f"{where}: landmarks {', '.join(missing)} are missing in metadata/landmarks/json")
    middles = np.stack([_middle(landmarks, side) for side in ("right", "left")])  # the right one: image left
    across = middles[1] - middles[0]
    below = landmarks["center.chin.tip"][1] < landmarks["center.nose.tip"][1] < middles[:, 1].mean()
    if across[0] <= 0 or not below or landmarks["center.nose.tip"][2] < middles[:, 2].max():
        raise InputError(f"{where}: the landmarks do not stand upright with x to the left eye and z forward")
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
        InputError: for a mesh that has no vertex in eyes or lips.
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
            raise InputError(
                f"{where}: no vertex of the mean lies in the {part}; are landmarks and mesh one?"
            )
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


_SPREAD = (
    3.0  # as for ICT FaceKit: standard deviation 0.9 of unit coefficients at ``HeadSpec.identity`` = 0.3
)
_EXTREME = 2.2


@dataclass(frozen=True)
class Statistics:
    """Mean and principal components of one quantity with three numbers a vertex.

    Attributes:
        mean: (V, 3).
        modes: (K, V, 3), scaled for normal coefficients of unit variance.
    """

    mean: Array
    modes: npt.NDArray[np.float32]

    def sample(self, rng: np.random.Generator, spread: float) -> Array:
        """(V, 3) of a random individual; coefficients are clipped at 2.2 standard deviations."""
        values = spread * np.clip(rng.normal(size=len(self.modes)), -_EXTREME, _EXTREME)
        return np.asarray(self.mean + np.tensordot(values.astype(np.float32), self.modes, 1))


@dataclass(frozen=True)
class BaselFile:
    """What is read of a file.

    Attributes:
        shape, expression: millimetres, y up, z toward the viewer; expression has zero mean or None.
        color: display-referred sRGB in [0, 1], or None.
        faces: (F, 3).
        landmarks: name -> (3,) position on the mean shape.
    """

    shape: Statistics
    expression: Statistics | None
    color: Statistics | None
    faces: npt.NDArray[np.uint32]
    landmarks: dict[str, Array]


def read_basel(path: Path) -> BaselFile:
    """Read a model file. Needs the extra ``basel`` (h5py).

    Raises:
        InputError: for a missing, damaged or foreign file, or a missing h5py.
    """
    try:
        import h5py
    except ImportError as error:
        raise InputError(
            "h5py: package not found, Basel models need it; run: pip install 'sfsnet_dr[basel]'"
        ) from error
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a Basel Face Model such as model2019_bfm.h5")
    try:
        with h5py.File(path, "r") as file:
            arrays = _Reader(path, file)
            shape = arrays.statistics("shape")
            count = len(shape.mean)
            return BaselFile(
                shape=shape,
                expression=arrays.statistics("expression", count) if "expression" in file else None,
                color=arrays.statistics("color", count) if "color" in file else None,
                faces=arrays.faces(count),
                landmarks=arrays.landmarks(),
            )
    except OSError as error:
        raise InputError(f"{path}: cannot be read as HDF5 ({error})") from error


class BaselFace:
    """A Basel model behind the ``FaceModel`` interface.

    Raises:
        InputError: as ``read_basel``, or where the mesh misses a region.
    """

    name = "basel"

    def __init__(self, path: Path) -> None:
        from sfsnet_dr.core.color import srgb_to_linear

        self._file = file = read_basel(path)
        self._to_linear = srgb_to_linear
        self.digest = digest_of(file.shape.mean, file.shape.modes, file.faces)
        self._frame = to_common_frame(file.landmarks, str(path))
        self.faces = file.faces
        neutral = self._frame.apply(file.shape.mean)
        points = {name: self._frame.apply(point) for name, point in file.landmarks.items()}
        self.weights = basel_regions(neutral, points, str(path))
        self.labels = self.weights.labels()
        self.normals = vertex_normals(neutral, file.faces)
        self.landmarks = find_landmarks(self.weights, self.labels)
        self._openings = [
            np.flatnonzero((self.weights.eyeball > 0.5) & (neutral[:, 0] * side > 0)) for side in (-1, 1)
        ]
        self._eye_offset = self._frame.eyes + EYE_SURFACE - self._middles(neutral)

    def shape(self, person: Person, streams: Streams, head: HeadSpec) -> HeadShape:
        """Random identity, and an expression with the scene's probability. The eyes look straight ahead."""
        points = self._file.shape.sample(streams(Stream.SHAPE), _SPREAD * head.identity)
        rng = streams(Stream.EXPRESSION)
        amount = rng.uniform(0.2, 1.0) * (rng.random() < head.expression)
        if self._file.expression is not None:
            points = points + self._file.expression.sample(rng, float(amount))
        vertices = self._frame.apply(points)
        return HeadShape(vertices, self._middles(vertices) + self._eye_offset)

    def colour(self, streams: Streams) -> Array | None:
        """(V, 3) linear albedo of the colour statistics, in [0.003, 0.9]."""
        if self._file.color is None:
            return None
        encoded = self._file.color.sample(streams(Stream.ALBEDO), 1.0)
        return np.clip(np.asarray(self._to_linear(np.clip(encoded, 0.0, 1.0))), 0.003, 0.9)

    def _middles(self, vertices: Array) -> Array:
        return np.stack([vertices[opening].mean(axis=0) for opening in self._openings])


class _Reader:
    """Datasets of an open file, each checked with a message that names it."""

    def __init__(self, path: Path, file: object) -> None:
        self._path, self._file = path, file

    def statistics(self, part: str, count: int | None = None) -> Statistics:
        mean = self._numbers(f"{part}/model/mean").ravel()
        basis = self._numbers(f"{part}/model/pcaBasis")
        variance = self._numbers(f"{part}/model/pcaVariance").ravel()
        wanted = (mean.size, variance.size)
        if mean.size % 3 or (count is not None and mean.size != 3 * count) or basis.shape != wanted:
            raise InputError(
                f"{self._path}: {part}/model: mean {mean.shape}, pcaBasis {basis.shape} and pcaVariance "
                f"{variance.shape} found, (3 V,), (3 V, K) and (K,) of one mesh are needed"
            )
        if (variance < 0).any():
            raise InputError(f"{self._path}: {part}/model/pcaVariance: negative values found")
        modes = (basis * np.sqrt(variance)).T.reshape(-1, mean.size // 3, 3)
        return Statistics(mean.reshape(-1, 3), modes.astype(np.float32))

    def faces(self, count: int) -> npt.NDArray[np.uint32]:
        cells = self._numbers("shape/representer/cells")
        faces = (cells.T if cells.shape[0] == 3 else cells).astype(np.int64)
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.min() < 0 or faces.max() >= count:
            raise InputError(
                f"{self._path}: shape/representer/cells: shape {cells.shape} found, (3, F) indices below "
                f"{count} are needed"
            )
        return faces.astype(np.uint32)

    def landmarks(self) -> dict[str, Array]:
        key = "metadata/landmarks/json"
        raw = self._dataset(key)
        text = np.asarray(raw).ravel()[0]
        try:
            table = json.loads(text.decode() if isinstance(text, bytes) else str(text))
            return {entry["id"]: np.array(entry["coordinates"], dtype=np.float64) for entry in table}
        except (ValueError, TypeError, KeyError) as error:
            raise InputError(
                f"{self._path}: {key}: is no list of landmarks with id and coordinates"
            ) from error

    def _numbers(self, key: str) -> Array:
        values = np.asarray(self._dataset(key))
        if not np.issubdtype(values.dtype, np.number) or values.size == 0 or not np.isfinite(values).all():
            raise InputError(
                f"{self._path}: {key}: finite numbers are needed, NaN, inf, text or nothing found"
            )
        return values.astype(np.float64)

    def _dataset(self, key: str) -> object:
        try:
            return self._file[key][()]  # type: ignore[index]
        except (KeyError, TypeError, AttributeError) as error:
            raise InputError(
                f"{self._path}: dataset {key!r} is missing; a statismo file is needed"
            ) from error
