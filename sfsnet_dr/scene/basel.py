"""Basel-style morphable models (BFM 2017, BFM 2019): mean and principal components in statismo's HDF5 layout.

The files cannot be passed on, so that users bring their own. Their surface is closed: no eyeballs, no mouth;
eyes are painted on it. Regions come from the landmarks that the files carry in ``metadata/landmarks/json``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.scene.basel_regions import basel_regions, to_common_frame
from sfsnet_dr.scene.face_model import EYE_SURFACE, HeadShape, Stream, Streams, digest_of, find_landmarks
from sfsnet_dr.scene.mesh import vertex_normals
from sfsnet_dr.scene.person import Person
from sfsnet_dr.scene.spec import HeadSpec

Array = npt.NDArray[np.float64]

_SPREAD = 3.0  # as for ICT FaceKit: standard deviation .9 of unit coefficients at ``HeadSpec.identity`` = .3
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
        BadInput: for a missing, damaged or foreign file, or a missing h5py.
    """
    try:
        import h5py
    except ImportError as error:
        raise BadInput(
            "h5py: package not found, Basel models need it; run: pip install 'sfsnet_dr[basel]'"
        ) from error
    if not path.is_file():
        raise BadInput(f"{path}: no such file; give a Basel Face Model such as model2019_bfm.h5")
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
        raise BadInput(f"{path}: cannot be read as HDF5 ({error})") from error


class BaselFace:
    """A Basel model behind the ``FaceModel`` interface.

    Raises:
        BadInput: as ``read_basel``, or where the mesh misses a region.
    """

    name = "basel"

    def __init__(self, path: Path) -> None:
        from sfsnet_dr.base.color import srgb_to_linear

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
        """(V, 3) linear albedo of the colour statistics, in [.003, .9]."""
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
            raise BadInput(
                f"{self._path}: {part}/model: mean {mean.shape}, pcaBasis {basis.shape} and pcaVariance "
                f"{variance.shape} found, (3 V,), (3 V, K) and (K,) of one mesh are needed"
            )
        if (variance < 0).any():
            raise BadInput(f"{self._path}: {part}/model/pcaVariance: negative values found")
        modes = (basis * np.sqrt(variance)).T.reshape(-1, mean.size // 3, 3)
        return Statistics(mean.reshape(-1, 3), modes.astype(np.float32))

    def faces(self, count: int) -> npt.NDArray[np.uint32]:
        cells = self._numbers("shape/representer/cells")
        faces = (cells.T if cells.shape[0] == 3 else cells).astype(np.int64)
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.min() < 0 or faces.max() >= count:
            raise BadInput(
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
            raise BadInput(f"{self._path}: {key}: is no list of landmarks with id and coordinates") from error

    def _numbers(self, key: str) -> Array:
        values = np.asarray(self._dataset(key))
        if not np.issubdtype(values.dtype, np.number) or values.size == 0 or not np.isfinite(values).all():
            raise BadInput(f"{self._path}: {key}: finite numbers are needed, NaN, inf, text or nothing found")
        return values.astype(np.float64)

    def _dataset(self, key: str) -> object:
        try:
            return self._file[key][()]  # type: ignore[index]
        except (KeyError, TypeError, AttributeError) as error:
            raise BadInput(f"{self._path}: dataset {key!r} is missing; a statismo file is needed") from error
