from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sfsnet_dr.core.color import luminance
from sfsnet_dr.scene.faces.appearance import skin_appearance
from sfsnet_dr.scene.faces.displacement import MILLIMETRE, displace_mesh
from sfsnet_dr.scene.faces.model import FaceModel
from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.faces.regions import RegionWeights
from sfsnet_dr.scene.faces.registry import load_face_model
from sfsnet_dr.scene.faces.zones import face_zones
from sfsnet_dr.scene.mesh import vertex_normals
from sfsnet_dr.scene.spec import HeadSpec, SceneSpec

Array = NDArray[np.float64]


def model() -> FaceModel:
    """A coarse head: what is tested here does not depend on the triangles' size."""
    return load_face_model(SceneSpec("test", "anny", head=HeadSpec(subdivision=1)))


def weights() -> RegionWeights:
    return model().weights


def normals() -> Array:
    return model().normals


def heights(seed: int, person: Person) -> Array:
    """(V,) mm along the normals, without hair."""
    neutral, normal = weights().neutral, normals()
    moved = displace_mesh(neutral, normal, weights(), np.random.default_rng(seed), person)
    return np.asarray(((moved - neutral) * normal).sum(axis=1) / MILLIMETRE)


def skin() -> NDArray[np.bool_]:
    zones = face_zones(weights())
    return np.asarray((zones.front > 0.9) & (weights().face > 0.5) & (weights().lips < 0.5))


@pytest.mark.parametrize(("age", "low", "high"), [(20.0, 0.04, 0.10), (80.0, 0.10, 0.22)])
def test_relief_is_a_tenth_of_a_millimetre_and_grows_with_age(age: float, low: float, high: float) -> None:
    for seed in range(6):
        height = heights(seed, Person(tone=20.0, male=1.0, age=age))[skin()]
        assert low < np.sqrt(np.mean(height**2)) < high  # 0.053 to 0.071 and 0.130 to 0.162 mm seen
        assert np.abs(height).max() < 1.5  # the deepest fold, 0.91 mm seen


def test_eyes_and_teeth_keep_their_place() -> None:
    height = heights(0, Person(tone=0.0, male=0.0, age=60.0))
    still = (weights().eyeball > 0.99) | (weights().teeth > 0.99) | (weights().tongue > 0.99)
    assert np.abs(height[still]).max() < 0.02  # a hundredth of what skin would move


def test_bumps_show_in_the_normals_without_turning_them_round() -> None:
    faces, neutral, normal = model().faces, weights().neutral, normals()
    for seed, age in ((0, 20.0), (1, 50.0), (2, 80.0)):
        person = Person(tone=20.0, male=1.0, age=age)
        hair = skin_appearance(weights(), np.random.default_rng(seed), person).hair
        moved = displace_mesh(neutral, normal, weights(), np.random.default_rng(seed), person, hair)
        cosine = (vertex_normals(moved, faces) * normal).sum(axis=1)[skin()]
        angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        assert 0.5 < angle.mean() < 8.0
        assert angle.max() < 75.0


def test_relief_is_independent_of_the_albedo() -> None:
    """Correlation of height and luminance over the cheeks of 30 people: it has no sign of its own."""
    zones, person = face_zones(weights()), Person(tone=20.0, male=0.0, age=30.0)
    cheek = zones.cheek > 0.3
    found = []
    for seed in range(30):
        look = skin_appearance(weights(), np.random.default_rng(seed), person)
        light = luminance(look.albedo)[cheek]
        found.append(np.corrcoef(heights(seed, person)[cheek], light)[0, 1])
    # Different octaves are nearly orthogonal even over one cheek: 0.021 at most for one person seen, and
    # 0.004 for the mean of 30, whose standard deviation is 0.002.
    assert float(np.abs(found).max()) < 0.08
    assert abs(float(np.mean(found))) < 0.015


def test_hair_rises_over_the_skin() -> None:
    neutral, normal, person = weights().neutral, normals(), Person(tone=0.0, male=1.0, age=30.0)
    raised = []
    for seed in range(12):
        hair = skin_appearance(weights(), np.random.default_rng(seed), person).hair
        moved = displace_mesh(neutral, normal, weights(), np.random.default_rng(seed), person, hair)
        height = ((moved - neutral) * normal).sum(axis=1) / MILLIMETRE
        brow, inside = hair.brow > 0.5, (face_zones(weights()).hairline > 0.3) & (hair.scalp > 0.8)
        assert height[brow].mean() > 0.1
        if inside.any():
            raised.append(height[inside].mean() / (hair.length / MILLIMETRE))
    np.testing.assert_allclose(raised, 0.9, atol=0.25)  # cover of 0.88 to 0.99 times the length, lumpy


def test_one_generator_one_relief() -> None:
    person = Person(tone=0.0, male=0.5, age=40.0)
    np.testing.assert_array_equal(heights(4, person), heights(4, person))
    assert np.abs(heights(4, person) - heights(5, person)).max() > 0.05
