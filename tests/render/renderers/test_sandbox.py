"""Somebody else's renderers: seen by the registry, rendered apart, and every failure told in one line."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from helpers import foreign

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.render.renderers.base import Budget, Capabilities
from sfsnet_dr.render.renderers.registry import find_renderer, renderers
from sfsnet_dr.render.renderers.sandbox import Outcome, run_sandboxed
from sfsnet_dr.scene.lights.light import Light, direction_from_angles
from sfsnet_dr.scene.spec import CameraSpec, SceneSpec
from sfsnet_dr.scene.subject import Subject, build_subject

SUN = Light("sun", None, ((direction_from_angles(30, 20), np.array([3.0, 2.0, 1.0])),))


@pytest.fixture(scope="module", autouse=True)
def foreign_package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    packages = foreign.install(tmp_path_factory.mktemp("foreign"))
    sys.path.append(str(packages))
    yield
    sys.path.remove(str(packages))


@pytest.fixture(scope="module")
def sphere() -> Subject:
    return build_subject(SceneSpec("sphere", "sphere", albedo=(0.6, 0.4, 0.2), camera=CameraSpec(size=16)))


def run(name: str, subject: Subject, seconds: float = 60.0) -> Outcome:
    return run_sandboxed(name, subject, SUN, Budget(samples=64), seconds)


def test_an_entry_point_becomes_a_renderer(sphere: Subject) -> None:
    assert "foreign-lambert" in renderers()
    outcome = run("foreign-lambert", sphere)
    assert outcome.failure is None
    assert outcome.capabilities == Capabilities(visibility=True)
    assert outcome.image is not None
    ours = find_renderer("mitsuba-llvm-direct").render(sphere, SUN, Budget(samples=256))
    inner = (slice(4, 12), slice(4, 12))
    # The middle of a pixel against its mean: the sphere's shading bends by 1 % over 1/14 of its radius.
    np.testing.assert_allclose(outcome.image[inner], ours[inner], rtol=0.02)
    assert 0 < outcome.seconds < 5


def test_the_name_of_one_of_ours_stays_ours(sphere: Subject) -> None:
    assert type(find_renderer("numpy-order2")).__name__ == "ShadingRenderer"
    assert "foreign_renderer:numpy-order2" in renderers()
    assert run("foreign_renderer:numpy-order2", sphere).failure is None


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("foreign-raises", "raised: ValueError: no idea of sphere"),
        ("foreign-exits", "died: the process was ended by SIGABRT: this library is too old"),
        ("foreign-shape", "no image: shape (3, 16, 16) found, (16, 16, 3) expected"),
        ("foreign-nan", "no image: 1 of 768 values are NaN or inf, finite ones expected"),
        ("foreign-dtype", "no image: dtype uint8 found, float32 or float64 expected"),
        ("foreign-list", "no image: list found, a NumPy array (H, W, 3) expected"),
        (
            "foreign-missing",
            "raised: ModuleNotFoundError: No module named 'foreign_renderer_that_is_missing'",
        ),
    ],
)
def test_a_failure_is_told_in_one_line(name: str, said: str, sphere: Subject) -> None:
    outcome = run(name, sphere)
    assert str(outcome.failure) == said
    assert outcome.image is None


def test_one_that_hangs_is_ended_and_started_again(sphere: Subject) -> None:
    for _ in range(2):
        outcome = run("foreign-hangs", sphere, seconds=1.5)
        assert str(outcome.failure) == "hung: no answer within 1.5 s; the process was ended"
        assert 1.5 <= outcome.seconds < 10.0


def test_our_own_run_here_and_fail_as_quietly(sphere: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run("numpy-order2", sphere).failure is None
    few = run_sandboxed("mitsuba-llvm-path", sphere, SUN, Budget(samples=1))
    assert str(few.failure).startswith("raised: InputError: samples: 1 found, at least 2")
    monkeypatch.setenv("SFSNET_DR_CYCLES_PYTHON", "/nowhere/python")
    missing = run("cycles-path", sphere)
    assert missing.failure is not None
    assert missing.failure.kind == "not installed"
    assert missing.failure.detail.endswith(": make cycles")


def test_a_name_that_nobody_has_is_bad_input(sphere: Subject) -> None:
    with pytest.raises(InputError, match="did you mean 'foreign-lambert'"):
        run("foreign-lambart", sphere)


def test_another_subject_is_not_mistaken_for_the_first(sphere: Subject) -> None:
    dark = build_subject(replace(sphere.spec, albedo=(0.3, 0.2, 0.1)))
    first, other, again = (run("foreign-lambert", subject).image for subject in (sphere, dark, sphere))
    assert first is not None
    assert other is not None
    assert again is not None
    np.testing.assert_allclose(other, first / 2)
    np.testing.assert_array_equal(again, first)
