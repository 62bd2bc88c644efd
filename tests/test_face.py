"""Seeded people: repeatable, independent streams, sane landmarks and regions, albedo within bounds."""

from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.scene.face import Face, sample_face, topology
from sfsnet_dr.scene.mesh import FACE_REGIONS, Region
from sfsnet_dr.scene.placement import project
from sfsnet_dr.scene.spec import HeadSpec, SceneSpec

SPEC = SceneSpec("test", "anny", head=HeadSpec(subdivision=1))


@pytest.fixture(scope="module")
def people() -> list[Face]:
    return [sample_face(seed, SPEC) for seed in range(6)]


def test_the_same_seed_is_the_same_person(people: list[Face]) -> None:
    again = sample_face(3, SPEC)
    np.testing.assert_array_equal(again.mesh.vertices, people[3].mesh.vertices)
    np.testing.assert_array_equal(again.mesh.albedo, people[3].mesh.albedo)


def test_seeds_differ(people: list[Face]) -> None:
    assert np.abs(people[0].mesh.vertices - people[1].mesh.vertices).max() > 0.02
    assert np.abs(people[0].mesh.albedo - people[1].mesh.albedo).max() > 0.05


def test_pose_limits_do_not_change_the_person() -> None:
    still = SceneSpec("still", "anny", head=HeadSpec(subdivision=1, yaw=0, pitch=0, roll=0))
    np.testing.assert_array_equal(sample_face(2, still).mesh.albedo, sample_face(2, SPEC).mesh.albedo)


def test_eyes_mouth_and_chin_are_where_they_belong(people: list[Face]) -> None:
    for face in people:
        seen = {name: project(point, SPEC.camera) for name, point in face.landmarks.items()}
        # 5 % scale, 5 degrees of roll about the middle and 2 pixels of shift move an eye by at most 7 pixels.
        assert np.abs(seen["eye_image_left"] - (45, 48)).max() < 7
        assert np.abs(seen["eye_image_right"] - (83, 48)).max() < 7
        assert seen["mouth_image_left"][0] < seen["mouth_image_right"][0]
        eyes = (seen["eye_image_left"] + seen["eye_image_right"]) / 2
        mouth = (seen["mouth_image_left"] + seen["mouth_image_right"]) / 2
        assert eyes[1] + 20 < mouth[1] < seen["chin"][1]


def test_face_normals_point_at_the_viewer_on_the_whole(people: list[Face]) -> None:
    for face in people:
        skin = np.isin(face.mesh.regions, FACE_REGIONS)
        assert face.mesh.normals[skin, 2].mean() > 0.4
        np.testing.assert_allclose(np.linalg.norm(face.mesh.normals, axis=1), 1.0, atol=1e-12)


def test_albedo_is_a_reflectance_and_regions_differ(people: list[Face]) -> None:
    for face in people:
        albedo, regions = face.mesh.albedo, face.mesh.regions
        assert 0.004 <= albedo.min() <= albedo.max() <= 0.9
        white = albedo[regions == Region.EYE_WHITE].mean()
        pupil = albedo[regions == Region.PUPIL].mean()
        assert pupil < 0.1 < white
        lips, skin = (albedo[regions == r].mean(axis=0) for r in (Region.LIPS, Region.SKIN))
        assert lips[0] / lips[1] > skin[0] / skin[1]  # redder


def test_every_region_exists_and_the_face_is_about_symmetric() -> None:
    shared = topology(1)
    assert set(shared.labels) == {int(region) for region in Region}
    x = shared.weights.neutral[:, 0]
    for region in (Region.SKIN, Region.LIPS, Region.BROW, Region.EAR, Region.IRIS):
        side = x[shared.labels == region]
        assert abs((side > 0).mean() - (side < 0).mean()) < 0.05


def test_one_colour_for_all_where_the_scene_says_so() -> None:
    plain = SceneSpec("plain", "anny", albedo=(0.1, 0.2, 0.3), head=HeadSpec(subdivision=0))
    np.testing.assert_array_equal(np.unique(sample_face(0, plain).mesh.albedo, axis=0), [[0.1, 0.2, 0.3]])
