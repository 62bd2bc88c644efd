"""The landmark fit finds the face that landmarks were made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from helpers.fake_face import IDENTITIES, fake_model
from scipy.spatial.transform import Rotation

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.estimation import morphable_fit as module
from sfsnet_dr.estimation.morphable_fit import (
    Placement,
    fit_landmarks,
    marking_offsets,
    place_model,
    project_landmarks,
)
from sfsnet_dr.scene.faces.linear_model import FaceModes

Array = npt.NDArray[np.float64]

COUNT = 12


@pytest.fixture(scope="module")
def model() -> FaceModes:
    return fake_model()


def random_faces(model: FaceModes, turn: float = 12.0) -> Placement:
    rng = np.random.default_rng(3)
    weights = rng.normal(size=(COUNT, len(model.modes)))
    weights[:, IDENTITIES:] = rng.uniform(0, 0.5, (COUNT, len(model.modes) - IDENTITIES))
    return Placement(
        Rotation.from_rotvec(np.radians(rng.uniform(-turn, turn, (COUNT, 3)))).as_matrix(),
        rng.uniform(-0.05, 0.05, (COUNT, 2)),
        rng.uniform(0.9, 1.05, COUNT),
        weights,
        np.zeros(COUNT),
    )


def marks(model: FaceModes, faces: Placement) -> Array:
    """Landmarks (N, 68, 2) as a detector would give them; the jaw's on the vertices that stand out most."""
    rows = []
    for index in range(len(faces)):
        seen = project_landmarks(place_model(model, faces, index))
        inner, strips = seen[model.inner], seen[model.outline]
        outward = strips[:, 0] - inner.mean(axis=0)
        jaw = strips[np.arange(17), np.einsum("lcx,lx->lc", strips, outward).argmax(axis=1)]
        rows.append(np.concatenate([jaw, inner]) + marking_offsets())
    return np.array(rows)


def turned_apart(found: Placement, truth: Placement) -> Array:
    """Degrees between rotations."""
    between = Rotation.from_matrix(found.rotation) * Rotation.from_matrix(truth.rotation).inv()
    return np.asarray(np.degrees(between.magnitude()))


def surfaces_apart(model: FaceModes, found: Placement, truth: Placement) -> Array:
    """Root mean square distance of all vertices in canonical pixels, x and y."""
    pairs = [
        (project_landmarks(place_model(model, found, k)), project_landmarks(place_model(model, truth, k)))
        for k in range(COUNT)
    ]
    return np.array([np.sqrt(((a - b) ** 2).sum(-1).mean()) for a, b in pairs])


def test_exact_landmarks_give_the_face(model: FaceModes, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the prior made weak nothing but the projection is left: an exact inverse."""
    monkeypatch.setattr(module, "SIGMA", np.full(68, 1e-3))
    monkeypatch.setattr(module, "_STEPS", 30)
    truth = random_faces(model)
    found = fit_landmarks(model, marks(model, truth))
    assert turned_apart(found, truth).max() < 0.05
    assert np.abs(found.weights - truth.weights).max() < 0.05
    assert surfaces_apart(model, found, truth).max() < 0.02
    assert found.error.max() < 1e-2


def test_with_its_prior_it_is_near(model: FaceModes) -> None:
    """At the default precision identities shrink toward the mean; pose and surface stay near."""
    truth = random_faces(model)
    found = fit_landmarks(model, marks(model, truth))
    assert turned_apart(found, truth).max() < 4.0  # 2.0 seen
    assert surfaces_apart(model, found, truth).max() < 2.0  # 1.0 seen
    correlation = np.corrcoef(found.weights[:, :IDENTITIES].ravel(), truth.weights[:, :IDENTITIES].ravel())
    assert correlation[0, 1] > 0.6


def test_a_turned_head_slides_its_jaw(model: FaceModes) -> None:
    """Landmarks on the outline of heads turned 30 degrees: held to fixed vertices they mislead."""
    faces = random_faces(model)
    yaw = np.where(np.arange(COUNT) % 2, 30.0, -30.0)
    truth = replace(faces, rotation=Rotation.from_euler("y", yaw[:, None], degrees=True).as_matrix())
    given = marks(model, truth)
    slid = turned_apart(fit_landmarks(model, given), truth).mean()
    fixed = replace(model, outline=model.outline[:, :1])
    held = turned_apart(fit_landmarks(fixed, given), truth).mean()
    assert slid < 4.0
    assert slid < held


def test_a_few_wrong_landmarks_hardly_matter(model: FaceModes) -> None:
    truth = random_faces(model)
    given = marks(model, truth)
    clean = fit_landmarks(model, given)
    rng = np.random.default_rng(0)
    wrong = rng.permuted(np.tile(np.arange(68) < 7, (COUNT, 1)), axis=1)  # a tenth
    spoilt = fit_landmarks(model, given + np.where(wrong[..., None], rng.normal(0, 12.0, given.shape), 0.0))
    assert surfaces_apart(model, spoilt, clean).mean() < 1.5


def test_missing_landmarks_are_done_without(model: FaceModes) -> None:
    truth = random_faces(model)
    given = marks(model, truth)
    given[:, :17] = np.nan
    found = fit_landmarks(model, given)
    assert np.isfinite(found.weights).all()
    assert turned_apart(found, truth).max() < 6.0
    given[3, 20:] = np.nan
    with pytest.raises(InputError, match="3 of a face found, 8 at least"):
        fit_landmarks(model, given)
    with pytest.raises(InputError, match="landmarks: shape"):
        fit_landmarks(model, given[:, :5])


def test_a_batch_is_its_faces(model: FaceModes) -> None:
    """Rounding differs between batch sizes, nothing else."""
    given = marks(model, random_faces(model))
    whole, one = fit_landmarks(model, given), fit_landmarks(model, given[4:5])
    np.testing.assert_allclose(whole.weights[4], one.weights[0], atol=1e-8)
    again = fit_landmarks(model, given)
    np.testing.assert_array_equal(whole.weights, again.weights)
