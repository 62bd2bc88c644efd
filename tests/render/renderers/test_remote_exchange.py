"""Subjects and lights as files: what is read is what was written."""

from __future__ import annotations

import gc
import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.render.renderers.remote import (
    light_folder,
    read_light,
    read_subject,
    write_light,
    write_subject,
)
from sfsnet_dr.scene.lights.light import Light, direction_from_angles
from sfsnet_dr.scene.mesh import Mesh
from sfsnet_dr.scene.spec import CameraSpec, HeadSpec, SceneSpec
from sfsnet_dr.scene.subject import Subject, build_subject


def head() -> Subject:
    """Has all there is: skin, gloss, a camera of its own and None in its specification."""
    camera, shape = CameraSpec(size=16, focal=(40.0, 90.0)), HeadSpec(subdivision=0, relief=False)
    return build_subject(SceneSpec("head", "anny", camera=camera, head=shape), seed=5)


def test_a_subject_comes_back_as_it_was(tmp_path: Path) -> None:
    subject = head()
    write_subject(tmp_path, subject)
    again = read_subject(tmp_path)
    assert (again.spec, again.seed, again.camera) == (subject.spec, subject.seed, subject.camera)
    assert subject.mesh.roughness_mix is not None
    for field in fields(Mesh):
        here, there = getattr(subject.mesh, field.name), getattr(again.mesh, field.name)
        assert here.dtype == there.dtype, field.name
        np.testing.assert_array_equal(here, there)


@pytest.mark.parametrize(("sky", "lamps"), [(True, 0), (True, 2), (False, 2)])
def test_a_light_comes_back_as_it_was(sky: bool, lamps: int, tmp_path: Path) -> None:
    environment = np.random.default_rng(0).random((64, 128, 3)) if sky else None
    suns = tuple((direction_from_angles(20.0 * k, 10.0), np.array([1.0, 0.1, k])) for k in range(lamps))
    write_light(tmp_path, Light("some", environment, suns))
    again = read_light(tmp_path)
    assert again.name == "some"
    if environment is None:
        assert again.environment is None
    else:
        np.testing.assert_array_equal(again.environment, environment)
    assert len(again.directional) == lamps
    for one, other in zip(suns, again.directional, strict=True):
        np.testing.assert_array_equal(one, other)


def test_folders_are_written_once_and_live_as_long_as_what_is_in_them() -> None:
    light, other = (Light("sun", None, ((direction_from_angles(0, 0), np.ones(3)),)) for _ in range(2))
    folder = light_folder(light)
    assert light_folder(light) == folder
    assert light_folder(other) != folder
    del light
    gc.collect()
    assert not folder.exists()
    assert light_folder(other).exists()


def test_another_format_is_refused(tmp_path: Path) -> None:
    write_light(tmp_path, Light("sun", None, ((direction_from_angles(0, 0), np.ones(3)),)))
    path = tmp_path / "light.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "format": 2}))
    with pytest.raises(InputError, match=r"light.json: format 2 found, 1 expected"):
        read_light(tmp_path)
