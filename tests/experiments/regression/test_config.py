"""Differences that are known: allowed up to their size where they belong, and nothing else with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.experiments.regression.config import (
    CONFIG,
    KnownDifference,
    RegressSpec,
    SceneLights,
    read_spec,
)
from sfsnet_dr.experiments.regression.expected import Expected, allow_known_differences
from sfsnet_dr.metrics.equivalence import Estimate, check_agreement, exact_estimate
from sfsnet_dr.render.renderers.base import Capabilities
from sfsnet_dr.scene.lights.presets import light_set
from sfsnet_dr.scene.subject import build_subject

EDGE = KnownDifference("mine", "rays start elsewhere", edges=0.1)
PART = KnownDifference("mine", "spectra", relative=0.02)
SPEC = RegressSpec(scenes=(SceneLights("sphere", ("constant",)),), renderers=("numpy-order2",), size=32)
MATRIX = 'renderers = ["numpy-order2"]\n[[scenes]]\nscene = "sphere"\nlights = ["constant"]\n[[known]]\n'


def half(edge: float) -> NDArray[np.float64]:
    """A picture that is bright to the right of an edge, in pixels; the pixel on it is mixed."""
    bright = np.clip(np.arange(32) + 1 - edge, 0, 1)
    return np.broadcast_to(bright[None, :, None], (32, 32, 3)) + 0.1


@pytest.fixture(scope="module")
def truth() -> Expected:
    subject, (light,) = build_subject(SPEC.scene("sphere")), light_set("constant")
    image = exact_estimate(half(16.5))
    return Expected(
        "formula",
        image,
        np.zeros_like(image.mean),
        "half",
        subject,
        light,
        Capabilities(order=2, visibility=False),
    )


def p_of(image: NDArray[np.float64], truth: Expected) -> float:
    noise = np.full_like(image, 1e-8)
    return check_agreement(Estimate(image, noise), truth.estimate, allowance=truth.allowance).p


def test_nothing_known_changes_nothing(truth: Expected) -> None:
    assert allow_known_differences(truth, []) is truth


def test_an_edge_may_lie_so_far_off_and_no_farther(truth: Expected) -> None:
    allowed = allow_known_differences(truth, [EDGE])
    assert p_of(half(16.59), truth) < 1e-9
    assert p_of(half(16.59), allowed) > 0.1
    assert p_of(half(16.61), allowed) < 1e-9
    assert p_of(1.002 * half(16.5), allowed) < 1e-9  # no edge, no allowance
    assert "allowed: contours 0.1 pixels apart (rays start elsewhere)" in allowed.words


def test_a_part_of_each_pixel_is_allowed(truth: Expected) -> None:
    allowed = allow_known_differences(truth, [PART])
    assert p_of(1.019 * half(16.5), truth) < 1e-9
    assert p_of(1.019 * half(16.5), allowed) > 0.1
    assert p_of(1.021 * half(16.5), allowed) < 1e-9
    assert "allowed: 2 % (spectra)" in allowed.words


def test_it_holds_for_its_renderer_and_scenes_only() -> None:
    spec = replace(SPEC, known=(EDGE, replace(PART, scenes=("bowl",))))
    assert spec.known_of("mine", "sphere") == [EDGE]
    assert len(spec.known_of("mine", "bowl")) == 2
    assert spec.known_of("yours", "bowl") == []


@pytest.mark.parametrize(
    ("known", "words"),
    [
        ('renderer = "x"\ncause = " "', "known: x: no cause found"),
        ('renderer = "x"\ncause = "y"\nrelative = 0.6', "relative: 0.6 found, 0 to 0.5 allowed"),
        ('renderer = "x"\ncause = "y"\nscenes = ["spere"]', "did you mean 'sphere'"),
        ('renderer = "x"', "cause"),
    ],
)
def test_a_difference_without_a_cause_or_place_is_refused(tmp_path: Path, known: str, words: str) -> None:
    path = tmp_path / "matrix.toml"
    path.write_text(MATRIX + known)
    with pytest.raises(InputError) as caught:
        read_spec(path)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)


def test_ours_are_allowed_nothing() -> None:
    """What this project renders itself is held to its truth, whatever else may be."""
    known = {k.renderer for k in read_spec(CONFIG).known}
    assert known <= {"cycles-path", "mitsuba-spectral-path"}
