"""Both ways to read ICT FaceKit give the same numbers; damaged files are named.

The files are small stand-ins of the same layout: the real model has 26,719 vertices, these have 40.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.faces import ict_files
from sfsnet_dr.scene.faces.ict_files import IctData, read_ict

VERTICES, MODES, UNITS = 40, 3, ("browDown_L", "jawOpen")


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ict_files, "VERTEX_COUNT", VERTICES)
    monkeypatch.setattr(ict_files, "IDENTITY_COUNT", MODES)


@pytest.fixture
def files() -> IctData:
    rng = np.random.default_rng(0)
    faces = rng.permuted(np.tile(np.arange(VERTICES), (20, 1)), axis=1)[:, :4]
    faces[::5, 3] = faces[::5, 2]  # triangles
    uv_faces = np.where(faces == faces, faces + 1, 0)
    return IctData(
        neutral=rng.normal(0.0, 8.0, (VERTICES, 3)).astype(np.float32),
        faces=faces.astype(np.int32),
        uv=rng.random((VERTICES + 1, 2)).astype(np.float32),
        uv_faces=uv_faces.astype(np.int32),
        identity=rng.normal(0.0, 0.3, (MODES, VERTICES, 3)).astype(np.float16),
        expression_names=UNITS,
        expression=rng.normal(0.0, 0.3, (len(UNITS), VERTICES, 3)).astype(np.float16),
    )


def write_compact(path: Path, files: IctData, **other: np.ndarray) -> Path:
    arrays = {name: getattr(files, name) for name in ("neutral", "faces", "uv", "uv_faces", "identity")}
    arrays |= {"expression": files.expression, "expression_names": np.array(files.expression_names)}
    np.savez_compressed(path, **(arrays | other))
    return path


def write_clone(folder: Path, files: IctData) -> Path:
    """The OBJ files that the arrays stand for, triangles written as such."""
    inside = folder / "FaceXModel"
    inside.mkdir(parents=True)
    shapes = {"generic_neutral_mesh": np.zeros((len(files.neutral), 3))}
    shapes |= {f"identity{k:03d}": shape for k, shape in enumerate(files.identity)}
    shapes |= dict(zip(files.expression_names, files.expression, strict=True))
    tail = [f"vt {u:.9f} {v:.9f}" for u, v in files.uv]
    for face, uv in zip(files.faces + 1, files.uv_faces + 1, strict=True):
        corners = 3 if face[3] == face[2] else 4
        tail.append("f " + " ".join(f"{a}/{b}/{a}" for a, b in zip(face[:corners], uv, strict=False)))
    for name, offset in shapes.items():
        points = files.neutral.astype(np.float64) + offset.astype(np.float64)
        head = ["# a comment", "mtllib x.mtl"] + [f"v {x:.12f} {y:.12f} {z:.12f}" for x, y, z in points]
        (inside / f"{name}.obj").write_text("\n".join([*head, *tail, ""]))
    return folder


def _assert_same(found: IctData, expected: IctData) -> None:
    assert found.expression_names == expected.expression_names
    for name in ("neutral", "faces", "uv", "uv_faces", "identity", "expression"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


def test_clone_and_compact_file_are_the_same(tmp_path: Path, files: IctData) -> None:
    clone = write_clone(tmp_path / "clone", files)
    _assert_same(read_ict(clone), files)
    _assert_same(read_ict(clone / "FaceXModel"), files)
    _assert_same(read_ict(write_compact(tmp_path / "ict.npz", files)), files)


def test_a_changed_vertex_is_noticed(tmp_path: Path, files: IctData) -> None:
    clone = write_clone(tmp_path, files)
    path = clone / "FaceXModel" / "jawOpen.obj"
    path.write_text(path.read_text().replace("v ", "v 9", 1))
    with pytest.raises(AssertionError, match="expression"):
        _assert_same(read_ict(clone), files)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("identity001.obj", None, "identity001.obj: no such file"),
        ("identity001.obj", "", "identity001.obj: no lines 'v '"),
        ("identity001.obj", "v 1 2 3\n", "identity001.obj: 1 vertices found, 40 needed"),
        ("jawOpen.obj", "v 1 2 three\n", "jawOpen.obj: a line 'v ' does not hold 3 numbers"),
        ("generic_neutral_mesh.obj", "v 1 2 3\nvt 0 0\nf 1 2\n", "faces of 3 or 4 corners"),
        ("generic_neutral_mesh.obj", "v 1 2 3\nvt 0 0\nf 1//1 2//1 3//1\n", "neither 3 nor 4 corners"),
    ],
)
def test_damaged_clones_are_named(
    tmp_path: Path, files: IctData, name: str, text: str | None, message: str
) -> None:
    path = write_clone(tmp_path, files) / "FaceXModel" / name
    path.unlink() if text is None else path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_ict(tmp_path)


def test_damaged_compact_files_are_named(tmp_path: Path, files: IctData) -> None:
    empty = tmp_path / "empty.npz"
    empty.write_bytes(b"")
    cut = write_compact(tmp_path / "cut.npz", files)
    cut.write_bytes(cut.read_bytes()[:2000])
    nan = files.neutral.copy()
    nan[3, 1] = np.nan
    pickled = np.array([{}], dtype=object)
    broken = {
        "no such file": tmp_path / "missing.npz",
        "empty.npz: cannot be read": empty,
        "cut.npz: cannot be read": cut,
        "neutral: NaN": write_compact(tmp_path / "a.npz", files, neutral=nan),
        "identity: shape": write_compact(tmp_path / "b.npz", files, identity=files.identity[:2]),
        "uv_faces: indices": write_compact(tmp_path / "c.npz", files, uv_faces=files.uv_faces + 9),
        "d.npz: cannot be read as .npz without pickles": write_compact(
            tmp_path / "d.npz", files, expression_names=pickled
        ),
    }
    for message, path in broken.items():
        with pytest.raises(InputError, match=message):
            read_ict(path)
    partial = tmp_path / "partial.npz"
    np.savez(partial, neutral=files.neutral)
    with pytest.raises(InputError, match="no array 'faces' found"):
        read_ict(partial)
