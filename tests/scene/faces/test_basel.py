"""A Basel-style model on a small file of the statismo layout that this test writes: an egg with landmarks."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.faces import measure_heads

from sfsnet_dr.core.color import srgb_to_linear
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.faces.basel import read_basel
from sfsnet_dr.scene.faces.face import sample_face
from sfsnet_dr.scene.faces.model import EYE_CENTRES, EYE_SURFACE, streams_of
from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.faces.registry import load_face_model
from sfsnet_dr.scene.mesh import Region, sphere_mesh, vertex_normals
from sfsnet_dr.scene.spec import HeadSpec, SceneSpec

h5py = pytest.importorskip("h5py")

#: Millimetres, where a face has them: side, height.
_POINTS = {
    "right.eye.corner_outer": (-45.0, 33.0),
    "right.eye.corner_inner": (-17.0, 33.0),
    "left.eye.corner_inner": (17.0, 33.0),
    "left.eye.corner_outer": (45.0, 33.0),
    "right.lips.corner": (-25.0, -34.0),
    "left.lips.corner": (25.0, -34.0),
    "center.lips.upper.outer": (0.0, -26.0),
    "center.lips.lower.outer": (0.0, -43.0),
    "center.chin.tip": (0.0, -78.0),
    "center.nose.tip": (0.0, -2.0),
}
MODES, VALUES = 4, ("shape", "expression", "color")


def _egg() -> tuple[np.ndarray, np.ndarray]:
    """A face-sized ellipsoid with a nose, in millimetres, and its triangles."""
    ball = sphere_mesh(1.0, rings=90)
    points = ball.vertices * (75.0, 110.0, 95.0)
    nose = np.exp(-((points[:, 0] / 10.0) ** 2) - ((points[:, 1] + 2.0) / 14.0) ** 2) * (points[:, 2] > 0)
    points[:, 2] += 22.0 * nose
    return points, ball.faces


def _landmarks(points: np.ndarray) -> str:
    front = points[points[:, 2] > 0]
    found = []
    for name, place in _POINTS.items():
        nearest = front[np.linalg.norm(front[:, :2] - place, axis=1).argmin()]
        found.append({"id": name, "coordinates": [*place, float(nearest[2])]})
    return json.dumps(found)


def write_basel(path: Path, **changed: object) -> Path:
    points, faces = _egg()
    rng = np.random.default_rng(0)
    datasets: dict[str, object] = {
        "shape/representer/cells": faces.T.astype(np.int32),
        "shape/representer/points": points.T,
        "metadata/landmarks/json": np.bytes_(_landmarks(points)),
    }
    means = {"shape": points, "expression": np.zeros_like(points), "color": np.full(points.shape, 0.6)}
    for part, deviation in zip(VALUES, (40.0, 15.0, 1.5), strict=True):
        waves = np.cos(points / 40.0 @ rng.normal(size=(3, MODES)) + rng.random(MODES))
        basis = (waves[:, None, :] * rng.normal(size=(1, 3, MODES))).reshape(-1, MODES)
        datasets[f"{part}/model/mean"] = means[part].ravel()
        datasets[f"{part}/model/pcaBasis"] = basis / np.linalg.norm(basis, axis=0)
        datasets[f"{part}/model/pcaVariance"] = np.full(MODES, deviation**2)
    with h5py.File(path, "w") as file:
        for key, value in (
            datasets | {key.replace("__", "/"): item for key, item in changed.items()}
        ).items():
            if value is not None:
                file[key] = value
    return path


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> SceneSpec:
    path = write_basel(tmp_path_factory.mktemp("basel") / "model.h5")
    return SceneSpec("basel", "basel", model_path=str(path))


def test_reader_scales_the_components(tmp_path: Path) -> None:
    file = read_basel(write_basel(tmp_path / "a.h5"))
    points, faces = _egg()
    np.testing.assert_allclose(file.shape.mean, points)
    np.testing.assert_array_equal(file.faces, faces)
    # A unit coefficient moves the whole face by the component's deviation: its basis column has length 1.
    np.testing.assert_allclose(np.linalg.norm(file.shape.modes, axis=(1, 2)), 40.0, rtol=1e-4)  # float32
    assert file.color is not None
    assert set(file.landmarks) == set(_POINTS)


def test_cells_may_lie_either_way_and_parts_may_be_missing(tmp_path: Path) -> None:
    left_out = {
        f"{part}__model__{key}": None for part in VALUES[1:] for key in ("mean", "pcaBasis", "pcaVariance")
    }
    file = read_basel(write_basel(tmp_path / "a.h5", shape__representer__cells=_egg()[1], **left_out))
    np.testing.assert_array_equal(file.faces, _egg()[1])
    assert file.expression is None
    assert file.color is None


def test_hundred_heads_are_sane(spec: SceneSpec) -> None:
    model = load_face_model(spec)
    heads = measure_heads(model, HeadSpec(expression=1.0), range(100))
    assert heads.finite.all()
    assert heads.inverted.max() < 0.01
    assert heads.eye_to_mouth.min() > 0.5
    assert heads.mouth_to_chin.min() > 0.2
    assert heads.iris_off.max() < 0.03  # painted at the middle of the opening


def test_the_mean_stands_in_the_common_frame(spec: SceneSpec) -> None:
    model = load_face_model(spec)
    still = model.shape(Person(0.0, 0.5, 40.0), streams_of(0), HeadSpec(identity=0.0, expression=0.0))
    # Depth excepted: a mesh gives the surface, and its eyes may look a little to one side of z.
    np.testing.assert_allclose(still.eyes[:, :2], (EYE_CENTRES + EYE_SURFACE)[:, :2], atol=2e-3)
    np.testing.assert_allclose(model.normals, vertex_normals(model.weights.neutral, model.faces))
    height = {region: model.weights.neutral[model.labels == region, 1].mean() for region in set(model.labels)}
    assert height[Region.BROW] > height[Region.EYE_WHITE] > height[Region.LIPS]
    assert {Region.IRIS, Region.PUPIL, Region.EYELID, Region.SKIN, Region.NECK} <= set(model.labels)


def test_its_colours_become_the_albedo(spec: SceneSpec) -> None:
    face = sample_face(4, spec)
    assert face.appearance is None
    colours = [load_face_model(spec).colour(streams_of(seed)) for seed in range(30)]
    people = np.array([colour for colour in colours if colour is not None])
    assert len(people) == 30
    np.testing.assert_array_equal(face.mesh.albedo, people[4])
    assert not np.array_equal(people[4], people[5])
    # 30 people of deviation 0.014 in sRGB: three standard errors and the curve of sRGB are below 0.02.
    np.testing.assert_allclose(people.mean(axis=(0, 1)), srgb_to_linear(np.full(3, 0.6)), atol=0.02)


def test_without_colours_the_skin_is_ours(tmp_path: Path) -> None:
    left_out = {f"color__model__{key}": None for key in ("mean", "pcaBasis", "pcaVariance")}
    path = write_basel(tmp_path / "grey.h5", **left_out)
    face = sample_face(4, SceneSpec("x", "basel", model_path=str(path)))
    assert face.appearance is not None


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"shape__model__mean": None}, "dataset 'shape/model/mean' is missing"),
        ({"shape__model__pcaVariance": np.ones(3)}, "shape/model: mean"),
        ({"shape__model__pcaVariance": -np.ones(MODES)}, "negative values"),
        ({"shape__model__pcaVariance": np.full(MODES, np.nan)}, "finite numbers are needed"),
        ({"shape__representer__cells": np.full((3, 5), 10**6)}, "cells: shape"),
        ({"metadata__landmarks__json": np.bytes_(b"[]")}, "landmarks right.eye.corner_outer"),
        ({"metadata__landmarks__json": np.bytes_(b"{")}, "is no list of landmarks"),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, changed: dict[str, object], message: str) -> None:
    path = write_basel(tmp_path / "damaged.h5", **changed)
    with pytest.raises(InputError, match=message) as caught:
        load_face_model(SceneSpec("x", "basel", model_path=str(path)))
    assert "damaged.h5" in str(caught.value)


def test_a_file_that_is_no_hdf5_is_named(tmp_path: Path) -> None:
    path = tmp_path / "text.h5"
    path.write_bytes(b"")
    with pytest.raises(InputError, match=r"text\.h5: cannot be read as HDF5"):
        read_basel(path)
