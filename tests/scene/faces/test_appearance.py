from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import kstest

from sfsnet_dr.core.color import linear_to_lab, luminance
from sfsnet_dr.scene.faces.appearance import GREATEST_ALBEDO, LEAST_ALBEDO, Appearance, skin_appearance
from sfsnet_dr.scene.faces.model import FaceModel
from sfsnet_dr.scene.faces.person import TONE_RANGE, Person
from sfsnet_dr.scene.faces.regions import RegionWeights
from sfsnet_dr.scene.faces.registry import load_face_model
from sfsnet_dr.scene.faces.skin_color import typology_angle
from sfsnet_dr.scene.faces.zones import face_zones
from sfsnet_dr.scene.mesh import Region
from sfsnet_dr.scene.spec import HeadSpec, SceneSpec

SEEDS = range(40)


def model() -> FaceModel:
    """A coarse head: what is tested here does not depend on the triangles' size."""
    return load_face_model(SceneSpec("test", "anny", head=HeadSpec(subdivision=1)))


def weights() -> RegionWeights:
    return model().weights


@cache
def people() -> tuple[Appearance, ...]:
    return tuple(skin_appearance(weights(), np.random.default_rng(seed)) for seed in SEEDS)


def bare(person: Appearance) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Plain skin of the front of the face."""
    zones = face_zones(weights())
    covered = person.hair.cover() + weights().lips + weights().eyelid + weights().eyeball + zones.socket
    return np.asarray((zones.front > 0.9) & (weights().face > 0.5) & (covered < 0.05))


def test_surfaces_are_finite_and_within_bounds() -> None:
    for person in people():
        count = len(weights().neutral)
        assert person.albedo.shape == (count, 3)
        assert person.roughness_mix.shape == (count,)
        assert person.albedo.min() >= LEAST_ALBEDO
        assert person.albedo.max() <= GREATEST_ALBEDO
        assert person.roughness_mix.min() >= 0.0
        assert person.roughness_mix.max() <= 1.0
        assert np.isfinite(person.albedo).all()


def test_skin_has_the_tone_of_the_person() -> None:
    for person in people():
        # Linear interpolation in log melanin between 60 nodes: 0.015 degrees seen.
        assert person.ita == pytest.approx(person.person.tone, abs=0.05)
        painted = float(np.median(typology_angle(person.albedo[bare(person)])))
        # Sun, blood and spots shift the median of a face against its plain skin: 7.5 degrees at most seen.
        assert abs(painted - person.person.tone) < 15.0


def test_tones_are_even_from_dark_to_very_light() -> None:
    tones = [Person.sample(np.random.default_rng(seed)).tone for seed in range(2000)]
    low, high = TONE_RANGE
    assert low < -30.0
    assert high > 55.0
    assert kstest(tones, "uniform", args=(low, high - low)).pvalue > 1e-3
    reached = np.array([person.ita for person in people()])
    assert reached.min() < -35.0
    assert reached.max() > 50.0


def test_lips_are_redder_than_the_skin_around() -> None:
    lips = weights().lips > 0.9
    redder = []
    for person in people():
        skin = linear_to_lab(person.skin.colour())
        redder.append(skin[lips, 1].mean() > skin[bare(person), 1].mean())
    assert all(redder)  # before make-up: by 0.8 to 10 in a*


def test_brows_are_darker_than_skin_unless_it_is_dark() -> None:
    for person in people():
        brow = person.hair.brow > 0.5
        if person.person.tone > 10.0 and person.person.age < 45 and brow.sum() > 10:
            skin = float(np.median(luminance(person.albedo[bare(person)])))
            assert float(np.median(luminance(person.albedo[brow]))) < skin


def test_beards_grow_on_men_only_and_not_on_lips() -> None:
    bearded = [person for person in people() if person.hair.beard.max() > 0.3]
    assert bearded
    for person in people():
        if person.person.male < 0.5:
            assert person.hair.beard.max() == 0.0
        assert person.hair.beard[weights().lips > 0.95].max(initial=0.0) < 0.1


def test_dark_skin_has_dark_hair_until_it_greys() -> None:
    young = [
        skin_appearance(weights(), np.random.default_rng(k), Person(tone=-40.0, male=1.0, age=20.0))
        for k in range(12)
    ]
    for person in young:
        scalp = person.hair.scalp > 0.5
        if scalp.any():
            assert float(luminance(np.median(person.hair.colour[scalp], axis=0))) < 0.05


def test_labels_follow_the_hairline() -> None:
    base = model().labels
    for person in people()[:10]:
        labels = person.labels(base)
        hairy = person.hair.scalp > 0.5
        assert not np.isin(labels[hairy], (Region.SKIN, Region.NECK)).any()
        assert not (labels[~hairy] == Region.SCALP).any()
        kept = np.isin(base, (Region.LIPS, Region.IRIS, Region.TEETH, Region.EAR))
        np.testing.assert_array_equal(labels[kept], base[kept])


def test_one_generator_one_face() -> None:
    first, again = (skin_appearance(weights(), np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first.albedo, again.albedo)
    np.testing.assert_array_equal(first.roughness_mix, again.roughness_mix)
    assert np.abs(first.albedo - people()[6].albedo).max() > 0.05


def test_parts_draw_from_streams_of_their_own() -> None:
    """The tone changes skin, not the shape of brows or the eyes' place among the draws."""
    person = Person(tone=0.0, male=0.0, age=30.0)
    first = skin_appearance(weights(), np.random.default_rng(3), person)
    second = skin_appearance(weights(), np.random.default_rng(3), replace(person, tone=20.0))
    np.testing.assert_array_equal(first.hair.brow, second.hair.brow)
    np.testing.assert_array_equal(first.hair.scalp, second.hair.scalp)
    assert np.abs(first.albedo - second.albedo).max() > 0.02


def test_eyes_shine_and_hair_does_not() -> None:
    for person in people()[:10]:
        assert person.roughness_mix[weights().eyeball > 0.9].min() > 0.99
        scalp = person.hair.scalp > 0.9
        assert person.roughness_mix[scalp].max(initial=0.0) < 0.4


def test_the_eyes_have_a_dark_pupil_inside_a_lighter_iris_inside_white() -> None:
    angle = weights().gaze_angle
    for person in people():
        pupil, iris, white = (
            float(luminance(person.albedo[where]).mean())
            for where in (angle < 7, (angle > 11) & (angle < 18), (angle > 32) & (angle < 60))
        )
        assert pupil < iris < white
