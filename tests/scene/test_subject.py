"""The scenes for judging renderers: each can be made and seen, and wrong names are answered."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.faces.skin_color import typology_angle
from sfsnet_dr.scene.mesh import SHAPES, Mesh
from sfsnet_dr.scene.spec import HeadSpec, SceneSpec
from sfsnet_dr.scene.subject import (
    build_subject,
    find_scene,
    load_spec_by_name,
    load_subject_by_name,
    validation_scenes,
)

NAMES = {
    "sphere", "plane", "bowl", "two_spheres", "relief", "head", "smile", "head_ict", "glossy_head",
    "dark_skin", "light_skin",
}  # fmt: skip


def coarse(name: str, **head: float) -> SceneSpec:
    spec = load_spec_by_name(name)
    return replace(spec, head=replace(spec.head, subdivision=0, **head))  # type: ignore[arg-type]


@cache
def face(name: str, **head: float) -> Mesh:
    return build_subject(coarse(name, **head)).mesh


def test_every_named_scene_loads_and_bears_its_name() -> None:
    assert set(validation_scenes()) == NAMES
    assert all(load_spec_by_name(name).name == name for name in NAMES)


@pytest.mark.parametrize("name", list(SHAPES))
def test_shapes_of_formulas_have_the_normals_of_their_triangles(name: str) -> None:
    mesh = load_subject_by_name(name).mesh
    corners = mesh.vertices[mesh.faces]
    edges = np.diff(corners, axis=1)
    across = np.cross(edges[:, 0], edges[:, 1])
    area = np.linalg.norm(across, axis=1)
    sound = area > 1e-9  # at the poles of balls, half the triangles have no area
    mean = mesh.normals[mesh.faces[sound]].mean(axis=1)
    cosine = np.einsum("fc,fc->f", across[sound] / area[sound, None], mean) / np.linalg.norm(mean, axis=1)
    # Chords: the normal of a triangle is that of the surface somewhere within it, so at most half its angle
    # off the mean of its corners; ripples turn by up to 9 degrees between neighbours, balls by 2.
    assert np.degrees(np.arccos(np.clip(cosine.min(), -1, 1))) < 4.5


def test_two_spheres_touch_nowhere_and_the_small_one_is_in_the_way_of_light() -> None:
    mesh = SHAPES["two_spheres"]((0.5, 0.5, 0.5))
    large, small = np.split(mesh.vertices, 2)
    between = small.mean(axis=0) - large.mean(axis=0)
    assert np.linalg.norm(between) > 0.62 + 0.26
    oblique = np.array([0.5, 0.5, np.sqrt(0.5)])  # the light at 45 degrees passes through both
    assert np.linalg.norm(np.cross(between, oblique)) < 0.26


def test_a_smile_moves_the_mouth_and_nothing_of_the_person() -> None:
    neutral, smile = face("head"), face("smile")
    moved = np.linalg.norm(neutral.vertices - smile.vertices, axis=1)
    assert moved.max() > 0.05
    assert np.array_equal(neutral.albedo, smile.albedo)
    assert (
        0.3
        < np.linalg.norm(face("smile", smile=0.5).vertices - neutral.vertices, axis=1).max() / moved.max()
        < 0.7
    )


def test_skin_tones_change_the_colour_and_not_the_head() -> None:
    dark, light = face("dark_skin"), face("light_skin")
    assert np.array_equal(dark.vertices, light.vertices)
    angles = [float(np.median(typology_angle(mesh.albedo[mesh.regions == 0]))) for mesh in (dark, light)]
    assert angles[0] < -30 < 45 < angles[1]


def test_heads_by_path_say_what_is_missing() -> None:
    with pytest.raises(InputError, match="head_ict: model_path is missing"):
        load_subject_by_name("head_ict")
    with pytest.raises(InputError, match=r"nowhere\.npz"):
        load_subject_by_name("head_ict", model_path="nowhere.npz")
    with pytest.raises(InputError, match="smile found"):
        build_subject(SceneSpec("x", "basel", model_path="x.h5", head=HeadSpec(smile=0.5)))


def test_unknown_names_get_the_nearest_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="scene 'haed': unknown; did you mean 'head'"):
        find_scene("haed")
    with pytest.raises(InputError, match=r"none\.toml: no such file"):
        find_scene(tmp_path / "none.toml")
    own = tmp_path / "own.toml"
    own.write_text('name = "own"\nshape = "bowl"\n')
    assert load_spec_by_name(own).shape == "bowl"
