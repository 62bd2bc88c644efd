"""The formulas against what is known of them, and against each other."""

from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.metrics.closed_form import by_harmonics, by_legendre, closed_form
from sfsnet_dr.scene.lights.light import Light, direction_from_angles
from sfsnet_dr.scene.spec import CameraSpec, SceneSpec
from sfsnet_dr.sh.projection import project_directional

SPHERE = SceneSpec(name="ball", shape="sphere", albedo=(0.2, 0.5, 0.8), camera=CameraSpec(size=24))
PLANE = SceneSpec(name="wall", shape="plane", albedo=(0.2, 0.5, 0.8), camera=CameraSpec(size=24))
ALBEDO = np.array([0.2, 0.5, 0.8])
LAMP = Light("lamp", None, ((direction_from_angles(40, 30), np.pi * np.array([1.0, 2.0, 3.0])),))


@pytest.mark.parametrize("order", [None, 0, 2, 4])
def test_a_furnace_shows_the_albedo(order: int | None) -> None:
    found = closed_form(SPHERE, Light("all", np.ones((64, 128, 3))), order, deferred=False)
    np.testing.assert_allclose(found.image[12, 12], ALBEDO, rtol=1e-9)
    assert (found.image[0, 0] == 0).all()
    assert (found.allowance[12, 12] < 1e-4).all()


def test_lamberts_law_on_a_plane() -> None:
    found = closed_form(PLANE, LAMP, None, deferred=False)
    cosine = direction_from_angles(40, 30)[2]
    np.testing.assert_allclose(found.image, np.broadcast_to(ALBEDO * [1, 2, 3] * cosine, (24, 24, 3)))


def test_legendre_and_harmonics_are_two_ways_to_the_same() -> None:
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    toward, irradiance = LAMP.directional[0]
    for order in (1, 2, 4, 8):
        series = by_legendre(normals @ toward, order)[:, None] * irradiance / np.pi
        harmonics = by_harmonics(normals, project_directional(toward, irradiance, order))
        np.testing.assert_allclose(series, harmonics, atol=1e-12)
    # What bands above 8 would add is largest at the kink of the clamped cosine: 3.5 % of its peak.
    assert np.abs(by_legendre(normals @ toward, 8) - np.maximum(normals @ toward, 0)).max() < 0.04


def test_the_left_of_the_picture_is_lit_from_the_left() -> None:
    left = Light("left", None, ((direction_from_angles(-60, 0), np.ones(3)),))
    image = closed_form(SPHERE, left, None, deferred=False).image
    assert image[:, :12].sum() > 3 * image[:, 12:].sum()


def test_other_scenes_have_no_formula() -> None:
    with pytest.raises(InputError, match="head: shape 'anny' found"):
        closed_form(SceneSpec(name="head", shape="anny"), LAMP, None, deferred=False)
