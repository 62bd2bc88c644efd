"""The ICT FaceKit head, where a user has one: set ``SFSNET_DR_ICT`` to the compact file or a clone.

The model is not part of the repository; its readers are tested on stand-ins in ``test_ict_files.py``.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.faces import away_share, measure_heads
from scene.faces.test_ict_files import write_clone, write_compact

from sfsnet_dr.scene.faces import ict_files
from sfsnet_dr.scene.faces.ict import IctFace
from sfsnet_dr.scene.faces.ict_files import read_ict
from sfsnet_dr.scene.faces.model import EYE_CENTRES, EYE_SURFACE, FaceModel, Stream, streams_of
from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.faces.registry import load_face_model
from sfsnet_dr.scene.mesh import Region
from sfsnet_dr.scene.spec import HeadSpec, SceneSpec

PATH = os.environ.get("SFSNET_DR_ICT", "")
pytestmark = pytest.mark.skipif(not PATH, reason="needs ICT FaceKit: set SFSNET_DR_ICT")

HEAD = HeadSpec(subdivision=0)


@pytest.fixture(scope="module")
def model() -> FaceModel:
    return load_face_model(SceneSpec("coarse", "ict", model_path=PATH, head=HEAD))


def test_hundred_heads_are_sane(model: FaceModel) -> None:
    heads = measure_heads(model, HEAD, range(100))
    assert heads.finite.all()
    # 14.6 % of the neutral face's vertices look away (nostrils, lips' inside); 13.3 to 16.2 % were seen.
    assert np.abs(heads.away - away_share(model, model.normals)).max() < 0.04
    assert heads.inverted.max() < 0.01  # 0.2 % seen, at the lids
    assert heads.eye_distance.min() > 0.50  # 54 to 69 mm seen
    assert heads.eye_distance.max() < 0.74
    assert heads.iris_off.max() < 0.05  # 2.7 mm seen: the gaze
    assert heads.eye_to_mouth.min() > 0.5
    assert heads.mouth_to_chin.min() > 0.2


def test_the_mean_stands_in_the_common_frame(model: FaceModel) -> None:
    streams = streams_of(0)
    shape = model.shape(
        Person.sample(streams(Stream.PERSON)), streams, HeadSpec(identity=0.0, expression=0.0)
    )
    np.testing.assert_allclose(shape.eyes, EYE_CENTRES + EYE_SURFACE, atol=1e-3)  # eyeballs mirror to 1e-5
    tip = model.weights.neutral[model.landmarks["nose_tip"]]
    np.testing.assert_allclose(tip, [0.0, 6.93, 1.68], atol=0.1)  # where Anny's nose is, within a centimetre


def test_every_region_has_vertices_and_no_shell_is_left(model: FaceModel) -> None:
    assert all((model.labels == region).any() for region in Region)
    # Lashes and lacrimal shells stand in front of the eyeballs: nothing but lids and eyes may lie there.
    neutral = model.weights.neutral
    away = np.abs(neutral - EYE_CENTRES[1] + (0.0, 0.01, 0.0))  # the opening's middle lies 1 mm lower
    over_eye = (away[:, :2] < (0.06, 0.025)).all(axis=1) & (neutral[:, 2] > 1.3)
    assert set(model.labels[over_eye]) <= {Region.IRIS, Region.PUPIL, Region.EYE_WHITE}


def test_finer_levels_keep_the_surface(model: FaceModel) -> None:
    fine = load_face_model(SceneSpec("fine", "ict", model_path=PATH, head=HeadSpec(subdivision=1)))
    assert len(fine.faces) > 2.5 * len(model.faces)  # the skin's quads become four; eyes and teeth stay
    tips = [each.weights.neutral[each.landmarks["nose_tip"]] for each in (model, fine)]
    assert (
        np.abs(tips[0] - tips[1]).max() < 0.02
    )  # Catmull-Clark shrinks a tip by a fraction of an edge (3 mm)


def test_a_clone_gives_the_same_head(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = read_ict(Path(PATH))
    names = ("jawOpen", "mouthUpperUp_L", "mouthUpperUp_R")
    part = replace(
        real,
        identity=real.identity[:2],
        expression_names=names,
        expression=real.expression[[real.expression_names.index(name) for name in names]],
    )
    monkeypatch.setattr(ict_files, "IDENTITY_COUNT", 2)
    clone = IctFace(write_clone(tmp_path, part), 0)
    compact = IctFace(write_compact(tmp_path / "part.npz", part), 0)
    assert clone.digest == compact.digest
    person = Person.sample(np.random.default_rng(0))
    shapes = [each.shape(person, streams_of(3), HEAD).vertices for each in (clone, compact)]
    np.testing.assert_array_equal(shapes[0], shapes[1])
