"""Reads ICT FaceKit (Li et al., CVPR 2020; MIT licence): the OBJ files of a clone, or one compact ``.npz``.

Both give the same numbers: blend shapes are offsets from the neutral mesh in centimetres, rounded to half
precision (at most 0.002 mm on the largest of them).
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError

Floats = npt.NDArray[np.float32]
Halves = npt.NDArray[np.float16]
Indices = npt.NDArray[np.int32]

#: Vertices of every file of the model; what each range of them is, is in ``ict_regions``.
VERTEX_COUNT = 26719
IDENTITY_COUNT = 100

_NEUTRAL = "generic_neutral_mesh.obj"
_KEYS = ("neutral", "faces", "uv", "uv_faces", "identity", "expression", "expression_names")


@dataclass(frozen=True)
class IctData:
    """The model as it is published.

    Attributes:
        neutral: (V, 3) cm, y up, z forward, x to the person's left.
        faces: (F, 4) vertices of quads; a triangle repeats its last one.
        uv: (T, 2) texture coordinates, v up.
        uv_faces: (F, 4) indices into ``uv``.
        identity: (100, V, 3) offsets for normal coefficients of unit variance.
        expression_names, expression: face units and their (E, V, 3) offsets.
    """

    neutral: Floats
    faces: Indices
    uv: Floats
    uv_faces: Indices
    identity: Halves
    expression_names: tuple[str, ...]
    expression: Halves


def read_ict(path: Path) -> IctData:
    """Read the model from a compact file, or from a clone (or its ``FaceXModel`` folder).

    The OBJ files take about 20 s, the compact file one.

    Raises:
        InputError: for a missing, damaged or foreign file, naming it.
    """
    if path.is_dir():
        folder = path / "FaceXModel" if (path / "FaceXModel").is_dir() else path
        return _read_folder(folder)
    if not path.is_file():
        raise InputError(f"{path}: no such file or folder; give ICT FaceKit's compact .npz or a clone of it")
    return _read_compact(path)


def _read_compact(path: Path) -> IctData:
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            missing = [key for key in _KEYS if key not in file]
            if missing:
                raise InputError(f"{path}: no array {missing[0]!r} found; {', '.join(_KEYS)} are needed")
            arrays = {key: file[key] for key in _KEYS}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: cannot be read as .npz without pickles ({error})") from error
    return _checked(
        str(path),
        neutral=arrays["neutral"],
        faces=arrays["faces"],
        uv=arrays["uv"],
        uv_faces=arrays["uv_faces"],
        identity=arrays["identity"],
        names=tuple(str(name) for name in arrays["expression_names"]),
        expression=arrays["expression"],
    )


def _read_folder(folder: Path) -> IctData:
    neutral, uv, faces, uv_faces = _read_mesh(folder / _NEUTRAL)
    identity = [folder / f"identity{k:03d}.obj" for k in range(IDENTITY_COUNT)]
    others = {_NEUTRAL} | {path.name for path in identity}
    expressions = sorted(path for path in folder.glob("*.obj") if path.name not in others)
    return _checked(
        str(folder),
        neutral=neutral.astype(np.float32),
        faces=faces,
        uv=uv.astype(np.float32),
        uv_faces=uv_faces,
        identity=_offsets(identity, neutral),
        names=tuple(path.stem for path in expressions),
        expression=_offsets(expressions, neutral),
    )


def _offsets(paths: list[Path], neutral: npt.NDArray[np.float64]) -> Halves:
    shapes = np.zeros((len(paths), *neutral.shape), dtype=np.float16)
    for k, path in enumerate(paths):
        shape = _positions(path, _lines(path))
        if shape.shape != neutral.shape:
            raise InputError(f"{path}: {len(shape)} vertices found, {len(neutral)} needed as in {_NEUTRAL}")
        shapes[k] = (shape - neutral).astype(np.float16)
    return shapes


def _read_mesh(
    path: Path,
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], Indices, Indices]:
    """Positions, texture coordinates, and both indices of the faces of an OBJ file."""
    lines = _lines(path)
    corners = [line.split()[1:] for line in lines if line.startswith(b"f ")]
    try:
        pairs = [[corner.split(b"/")[:2] for corner in face] for face in corners]
        padded = [face if len(face) == 4 else [*face, face[-1]] for face in pairs]
        index = np.array(padded, dtype=np.int32) - 1
    except ValueError as error:
        raise InputError(f"{path}: a face is neither 3 nor 4 corners of vertex/texture indices") from error
    if index.ndim != 3 or index.shape[1:] != (4, 2):
        raise InputError(f"{path}: faces of 3 or 4 corners with vertex/texture indices are needed")
    return _positions(path, lines), _numbers(path, lines, b"vt ", 2), index[..., 0], index[..., 1]


def _positions(path: Path, lines: list[bytes]) -> npt.NDArray[np.float64]:
    return _numbers(path, lines, b"v ", 3)


def _numbers(path: Path, lines: list[bytes], kind: bytes, columns: int) -> npt.NDArray[np.float64]:
    rows = [line[len(kind) :].split()[:columns] for line in lines if line.startswith(kind)]
    try:
        values = np.array(rows, dtype=np.float64)
    except ValueError as error:
        raise InputError(f"{path}: a line {kind.decode()!r} does not hold {columns} numbers") from error
    if values.ndim != 2:
        raise InputError(f"{path}: no lines {kind.decode()!r} found; the file is damaged")
    return values


def _lines(path: Path) -> list[bytes]:
    try:
        return path.read_bytes().splitlines()
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; {path.parent} is no complete FaceXModel folder") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({type(error).__name__})") from error


def _checked(
    where: str,
    *,
    neutral: npt.NDArray[np.floating],
    faces: npt.NDArray[np.integer],
    uv: npt.NDArray[np.floating],
    uv_faces: npt.NDArray[np.integer],
    identity: npt.NDArray[np.floating],
    names: tuple[str, ...],
    expression: npt.NDArray[np.floating],
) -> IctData:
    wanted = {
        "neutral": (neutral.shape, (VERTEX_COUNT, 3)),
        "identity": (identity.shape, (IDENTITY_COUNT, VERTEX_COUNT, 3)),
        "expression": (expression.shape, (len(names), VERTEX_COUNT, 3)),
        "faces": (faces.shape, (len(faces), 4)),
        "uv_faces": (uv_faces.shape, faces.shape),
        "uv": (uv.shape, (len(uv), 2)),
    }
    for name, (found, expected) in wanted.items():
        if found != expected:
            raise InputError(f"{where}: {name}: shape {found} found, {expected} needed for ICT FaceKit")
    for name, values in (
        ("neutral", neutral),
        ("uv", uv),
        ("identity", identity),
        ("expression", expression),
    ):
        if not np.issubdtype(values.dtype, np.floating) or not np.isfinite(values).all():
            raise InputError(f"{where}: {name}: NaN, inf or no floating-point numbers found")
    for name, index, count in (("faces", faces, VERTEX_COUNT), ("uv_faces", uv_faces, len(uv))):
        if not np.issubdtype(index.dtype, np.integer) or index.min() < 0 or index.max() >= count:
            raise InputError(f"{where}: {name}: indices from 0 to {count - 1} are needed")
    return IctData(
        neutral=neutral.astype(np.float32),
        faces=faces.astype(np.int32),
        uv=uv.astype(np.float32),
        uv_faces=uv_faces.astype(np.int32),
        identity=identity.astype(np.float16) + np.float16(0.0),  # no negative zeros: files differ in those
        expression_names=names,
        expression=expression.astype(np.float16) + np.float16(0.0),
    )
