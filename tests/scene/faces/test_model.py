"""Face models behind one interface: Anny sane for a hundred seeds, in place in the image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.faces import away_share, measure_heads

from sfsnet_dr.core.config import as_dict
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.faces.face import sample_face, sample_shape
from sfsnet_dr.scene.faces.model import EYE_CENTRES, FaceModel
from sfsnet_dr.scene.faces.pose import project_points
from sfsnet_dr.scene.faces.registry import load_face_model
from sfsnet_dr.scene.mesh import Region, vertex_normals
from sfsnet_dr.scene.spec import CameraSpec, HeadSpec, SceneSpec

COARSE = SceneSpec("coarse", "anny", head=HeadSpec(subdivision=0))


@pytest.fixture(scope="module")
def model() -> FaceModel:
    return load_face_model(COARSE)


def test_hundred_heads_are_sane(model: FaceModel) -> None:
    heads = measure_heads(model, COARSE.head, range(100))
    assert heads.finite.all()
    # 5.3 % of the neutral face looks away from the camera (jaw, lips' inside); up to 10.1 % were seen.
    assert heads.away.max() < away_share(model, model.normals) + 0.08
    # Lids that roll over: at most 0.26 % were seen, an inverted face would be 100 %.
    assert heads.inverted.max() < 0.01
    # Adults' pupils are 54 to 74 mm apart (Dodgson 2004); measured 54 to 75, with a margin for other seeds.
    assert heads.eye_distance.min() > 0.48
    assert heads.eye_distance.max() < 0.80
    # The iris lies in the eye's opening, which is 3 mm to the rim above and 12 mm wide; the gaze moves it.
    assert heads.iris_off.max() < 0.06
    assert heads.eye_to_mouth.min() > 0.4
    assert heads.mouth_to_chin.min() > 0.2


def test_an_inverted_head_is_noticed(model: FaceModel) -> None:
    mirrored = model.weights.neutral * (-1.0, 1.0, 1.0)  # turns all triangles inside out
    assert away_share(model, vertex_normals(mirrored, model.faces)) > 0.9


def test_regions_lie_where_a_face_has_them() -> None:
    model = load_face_model(SceneSpec("fine", "anny"))
    neutral, labels = model.weights.neutral, model.labels
    assert all((labels == region).any() for region in Region), "every region has vertices"
    height = {region: neutral[labels == region, 1].mean() for region in Region}
    assert height[Region.SCALP] > height[Region.EYELID] > height[Region.LIPS] > neutral[:, 1].min()
    assert height[Region.BROW] > height[Region.IRIS] > height[Region.LIPS]
    irises = neutral[labels == Region.IRIS]
    for side, centre in zip((-1, 1), EYE_CENTRES, strict=True):
        mine = irises[irises[:, 0] * side > 0]
        assert np.abs(mine.mean(axis=0)[:2] - centre[:2]).max() < 0.005  # half a millimetre


def test_a_still_face_is_symmetric() -> None:
    still = SceneSpec("still", "anny", head=HeadSpec(subdivision=0, identity=0.0, expression=0.0))
    eyes = np.mean([sample_shape(seed, still).eyes for seed in range(20)], axis=0)
    np.testing.assert_allclose(eyes[0], eyes[1] * (-1.0, 1.0, 1.0), atol=1e-4)  # MakeHuman's own rounding
    # Sex, age and ancestry remain; over 20 people they move the pupils by 1 mm from the template's.
    assert np.abs(eyes[1, 0] - EYE_CENTRES[1, 0]) < 0.02


def test_eyes_land_on_their_pixels() -> None:
    head = HeadSpec(subdivision=0, yaw=0.0, roll=0.0, scale_jitter=0.0, shift_jitter=0.0)
    face = sample_face(3, SceneSpec("x", "anny", head=head))
    camera = face.pose.camera(CameraSpec())
    seen = [project_points(face.landmarks[f"eye_image_{side}"], camera) for side in ("left", "right")]
    np.testing.assert_allclose(seen, [[45.0, 48.0], [83.0, 48.0]], atol=0.01)  # place() stops at 0.001 pixel
    mouth = (face.landmarks["mouth_image_left"] + face.landmarks["mouth_image_right"]) / 2
    assert 48.0 < project_points(mouth, camera)[1] < project_points(face.landmarks["chin"], camera)[1] < 140.0


def test_a_seed_is_a_person() -> None:
    one, again, other = (sample_face(seed, COARSE) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one.mesh.vertices, again.mesh.vertices)
    np.testing.assert_array_equal(one.mesh.albedo, again.mesh.albedo)
    assert np.abs(one.mesh.vertices - other.mesh.vertices).max() > 0.01


def test_a_deeper_head_differs_along_the_line_of_sight_alone() -> None:
    front = HeadSpec(subdivision=0, yaw=0.0, pitch=0.0, roll=0.0, scale_jitter=0.0, shift_jitter=0.0)
    far = CameraSpec(distance=1e4)  # so that depth does not show in perspective
    usual, deep, drawn = (
        sample_face(4, SceneSpec("x", "anny", camera=far, head=replace(front, depth_scale=depth)))
        for depth in ((1.0, 1.0), (1.3, 1.3), (1.0, 1.3))
    )
    eyes = usual.landmarks["eye_image_left"]
    for face, factor in ((deep, 1.3), (drawn, None)):
        before, after = usual.mesh.vertices - eyes, face.mesh.vertices - face.landmarks["eye_image_left"]
        np.testing.assert_allclose(after[:, :2], before[:, :2], atol=1e-3)  # perspective at 10,000 units
        ratio = after[:, 2].std() / before[:, 2].std()
        assert 1.0 < ratio < 1.3 if factor is None else abs(ratio - factor) < 1e-3
        np.testing.assert_allclose(after[:, 2], ratio * before[:, 2], atol=1e-3)
        np.testing.assert_array_equal(face.mesh.albedo, usual.mesh.albedo)
    assert "depth" not in as_dict(front), "data sets made before keep their fingerprint"


def test_relief_moves_skin_by_less_than_hair() -> None:
    flat = SceneSpec("x", "anny", head=HeadSpec(subdivision=0, relief=False), albedo=(0.5, 0.5, 0.5))
    bumpy = SceneSpec("x", "anny", head=HeadSpec(subdivision=0), albedo=(0.5, 0.5, 0.5))
    moved = np.linalg.norm(sample_face(2, flat).mesh.vertices - sample_face(2, bumpy).mesh.vertices, axis=1)
    # One scene unit is about 104 mm; without hair, wrinkles are the deepest relief, below 1.5 mm.
    assert 0.0 < moved.max() < 1.5 / 104


def test_the_scene_may_give_the_albedo() -> None:
    face = sample_face(1, SceneSpec("x", "anny", albedo=(0.1, 0.2, 0.3), head=HeadSpec(subdivision=0)))
    np.testing.assert_array_equal(np.unique(face.mesh.albedo, axis=0), [[0.1, 0.2, 0.3]])
    assert face.appearance is None


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (SceneSpec("x", "sphere"), "shape 'sphere' found"),
        (SceneSpec("x", "ict"), "model_path is missing"),
        (SceneSpec("x", "ict", model_path="/nowhere/ict.npz"), "ict.npz: no such file"),
        (SceneSpec("x", "basel", model_path="/nowhere/bfm.h5"), "bfm.h5: no such file"),
        (SceneSpec("x", "basel", model_path="a", head=HeadSpec(subdivision=1)), "'basel' allows 0 only"),
    ],
)
def test_bad_models_are_named(spec: SceneSpec, message: str) -> None:
    with pytest.raises(InputError, match=message):
        sample_face(0, spec)
