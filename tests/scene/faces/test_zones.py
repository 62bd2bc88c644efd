from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from sfsnet_dr.scene.faces.appearance import skin_appearance
from sfsnet_dr.scene.faces.eyes_makeup import paint_makeup
from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.faces.regions import RegionWeights
from sfsnet_dr.scene.faces.registry import load_face_model
from sfsnet_dr.scene.faces.zones import face_zones
from sfsnet_dr.scene.spec import HeadSpec, SceneSpec


def weights() -> RegionWeights:
    return load_face_model(SceneSpec("test", "anny", head=HeadSpec(subdivision=1))).weights


def test_zones_lie_where_their_names_say() -> None:
    zones, position = face_zones(weights()), weights().neutral
    for name, low, high in (
        ("forehead", 7.45, 8.6),
        ("socket", 7.25, 7.5),
        ("under_eye", 7.0, 7.25),
        ("cheek", 6.6, 7.15),
        ("nose", 6.75, 7.1),
        ("moustache", 6.4, 6.85),
        ("chin", 6.1, 6.5),
        ("jaw", 5.7, 7.3),
    ):
        inside = getattr(zones, name) > 0.5
        assert inside.any(), name
        assert low < position[inside, 1].min(), name
        assert position[inside, 1].max() < high, name


def test_zones_spare_lips_eyes_and_the_inside_of_the_mouth() -> None:
    zones = face_zones(weights())
    for beard in (zones.moustache, zones.jaw):
        for part in (weights().lips, weights().eyeball, weights().teeth, weights().tongue):
            assert beard[part > 0.99].max() < 0.02


def test_zones_are_the_same_on_both_sides() -> None:
    zones, position = face_zones(weights()), weights().neutral
    mirrored = {tuple(point): k for k, point in enumerate(np.round(position * (-1, 1, 1), 3) + 0.0)}
    pairs = [(k, mirrored.get(tuple(point))) for k, point in enumerate(np.round(position, 3) + 0.0)]
    left, right = np.array([pair for pair in pairs if pair[1] is not None], dtype=np.int64).T
    assert len(left) > 0.5 * len(position)
    for name in ("cheek", "socket", "under_eye", "crown"):  # those that no painted mask of the model enters
        field = getattr(zones, name)
        # Twins of the mesh agree to a thousandth of a decimetre, over edges of 0.055 and wider.
        np.testing.assert_allclose(field[left], field[right], atol=0.03)


def test_a_longer_face_gets_the_same_zones() -> None:
    """Stretch everything below the eyes by a tenth: the zones move with mouth, nose and chin."""
    position = weights().neutral
    eye = 7.284
    stretched = np.where(position[:, 1] < eye, eye + 1.1 * (position[:, 1] - eye), position[:, 1])
    longer = replace(weights(), neutral=np.stack([position[:, 0], stretched, position[:, 2]], axis=1))
    before, after = face_zones(weights()), face_zones(longer)
    for name in ("moustache", "chin", "nose"):
        moved = np.abs(getattr(before, name) - getattr(after, name))
        assert moved[position[:, 1] > 6.1].max() < 0.02, name


def test_a_head_without_features_keeps_its_heights() -> None:
    count = 50
    position = np.random.default_rng(0).uniform((-0.7, 6.0, 0.5), (0.7, 8.0, 1.6), (count, 3))
    plain = RegionWeights(position, *[np.zeros(count)] * (len(fields(RegionWeights)) - 1))
    np.testing.assert_allclose(face_zones(plain).place[:, 1], position[:, 1])


def test_makeup_is_worn_by_women_and_stays_in_place() -> None:
    zones, bare = face_zones(weights()), np.full((len(weights().neutral), 3), 0.3)
    worn = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        man, gloss = paint_makeup(bare, weights(), zones, Person(tone=10.0, male=0.9, age=30.0), rng)
        np.testing.assert_array_equal(man, bare)
        assert gloss.max() == 0.0
        woman, gloss = paint_makeup(bare, weights(), zones, Person(tone=10.0, male=0.1, age=30.0), rng)
        worn += bool((woman != bare).any())
        chin = zones.chin * (1.0 - weights().lips) > 0.9
        np.testing.assert_allclose(woman[chin], bare[chin], atol=0.03)
        assert gloss[weights().lips < 0.01].max() < 0.01
    assert 10 <= worn <= 30  # half of 40, three standard deviations


def test_cheeks_hold_more_blood_than_the_chin_on_average() -> None:
    zones = face_zones(weights())
    ratio = []
    for seed in range(12):
        blood = skin_appearance(weights(), np.random.default_rng(seed)).skin.blood
        ratio.append(blood[zones.cheek > 0.8].mean() / blood[zones.forehead > 0.8].mean())
    assert 1.1 < float(np.exp(np.mean(np.log(ratio)))) < 2.5
