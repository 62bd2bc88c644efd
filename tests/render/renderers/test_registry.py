"""The renderers by name: which there are, and that those of one model agree."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.render.renderers.base import Budget, Image
from sfsnet_dr.render.renderers.registry import find_renderer, is_built_in, renderers
from sfsnet_dr.render.renderers.sh import surface_maps
from sfsnet_dr.scene.lights.light import Light, direction_from_angles
from sfsnet_dr.scene.spec import CameraSpec, HeadSpec, SamplingSpec, SceneSpec
from sfsnet_dr.scene.subject import Subject, build_subject
from sfsnet_dr.sh.kernel import clamped_cosine
from sfsnet_dr.sh.projection import equirect_directions

#: Few rays: the same are given to every form.
FEW = SamplingSpec(spp=16, paths_per_hit=1)
COLOUR = (0.6, 0.4, 0.2)
COLOURED = SceneSpec("sphere", "sphere", albedo=COLOUR, camera=CameraSpec(size=32), sampling=FEW)
HEAD = SceneSpec(
    "head", "anny", camera=CameraSpec(size=32), head=HeadSpec(subdivision=0, relief=False), sampling=FEW
)
BUDGET = Budget()


@pytest.fixture(scope="module")
def sphere() -> Subject:
    return build_subject(COLOURED)


@pytest.fixture(scope="module")
def head() -> Subject:
    return build_subject(HEAD, seed=3)


def sunny() -> Light:
    """A sky that is bluer above, and a sun from the upper right."""
    up = equirect_directions(64, 128)[..., 1:2]
    return Light(
        "sunny",
        0.3 + 0.2 * up * [0.5, 0.8, 1.0],
        ((direction_from_angles(35, 40), np.array([2.0, 1.8, 1.4])),),
    )


def render(name: str, subject: Subject, light: Light, budget: Budget = BUDGET) -> Image:
    return find_renderer(name).render(subject, light, budget)


@pytest.mark.parametrize("order", range(5))
def test_the_three_forms_of_shading_agree(order: int, sphere: Subject, head: Subject) -> None:
    for subject in (sphere, head):
        oracle = render(f"numpy-order{order}", subject, sunny())
        assert oracle.max() > 0.1
        for backend in ("torch", "drjit"):
            image = render(f"{backend}-order{order}", subject, sunny())
            # Sums of up to 25 terms in float32: 25 roundings of 6e-8 of values of about 1.
            np.testing.assert_allclose(image, oracle, atol=1.5e-6)


@pytest.mark.parametrize("kind", ["visibility", "bounce"])
@pytest.mark.parametrize("order", [2, 4])
def test_both_forms_of_transport_agree(order: int, kind: str, head: Subject) -> None:
    names = [f"{backend}-order{order}-{kind}" for backend in ("numpy", "drjit")]
    oracle, image = (render(name, head, sunny()) for name in names)
    assert oracle.max() > 0.1
    np.testing.assert_allclose(image, oracle, atol=1.5e-6)  # as above


def test_shading_of_a_directional_light_is_the_truncated_cosine(sphere: Subject) -> None:
    # sum_l (2 l + 1) / 4 pi A_l P_l(cos) E albedo / pi, by the addition theorem; not from our basis.
    toward, power = direction_from_angles(20, 30), np.array([1.0, 2.0, 3.0])
    maps = surface_maps(sphere)
    cosine = np.tensordot(toward, maps.normal[0], axes=1)
    for order in range(5):
        bands = (2 * np.arange(order + 1) + 1) / (4 * np.pi) * clamped_cosine(order) / np.pi
        shading = np.polynomial.legendre.legval(cosine, bands)[..., None] * power
        image = render(f"numpy-order{order}", sphere, Light("lamp", None, ((toward, power),)))
        covered = np.moveaxis(maps.albedo[0], 0, -1)
        np.testing.assert_allclose(image, covered * shading, atol=1e-6)  # the maps are float32


def test_a_ball_in_uniform_light_shows_its_albedo_and_its_share_of_the_silhouette(sphere: Subject) -> None:
    light = Light("uniform", np.ones((64, 128, 3)))
    traced = render("mitsuba-llvm-direct", sphere, light, Budget(samples=256))
    names = [name for name in renderers() if name.startswith("numpy-")]
    assert len(names) == 9
    for name in names:
        image = render(name, sphere, light)
        assert image.shape == (32, 32, 3)
        np.testing.assert_allclose(image[16, 16], COLOUR, atol=2e-4)
        # 64 rays a pixel place an edge to about 1 %, 256 paths to 3 %: 5 standard deviations of 0.6 x 3 %.
        np.testing.assert_allclose(image, traced, atol=0.09)
        assert (image[0] == 0).all()


def test_visibility_darkens_and_a_bounce_brightens_a_head(head: Subject) -> None:
    light = Light("uniform", np.ones((64, 128, 3)))
    plain, shadowed, bounced = (
        render(f"numpy-order4{kind}", head, light).mean() for kind in ("", "-visibility", "-bounce")
    )
    assert shadowed < 0.99 * plain
    assert shadowed * 1.005 < bounced < plain


def test_the_path_tracer_is_seeded_and_follows_subject_and_light(sphere: Subject) -> None:
    few = Budget(samples=4, seed=1)
    first = render("mitsuba-llvm-direct", sphere, sunny(), few)
    other = build_subject(replace(COLOURED, albedo=(0.1, 0.1, 0.1)))
    dark = render("mitsuba-llvm-direct", other, sunny(), few)
    again = render("mitsuba-llvm-direct", sphere, sunny(), few)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_allclose(dark, first * (0.1 / np.array(COLOUR)), rtol=1e-4)
    assert (render("mitsuba-llvm-direct", sphere, sunny(), Budget(4, 2)) != first).any()


def test_every_renderer_says_what_it_is() -> None:
    for name in renderers():
        found = find_renderer(name)
        assert found.name == name
        assert is_built_in(name)
        assert found.capabilities.noisy == (not name.startswith(("numpy", "torch", "drjit")))


def test_an_unknown_name_gets_the_nearest() -> None:
    with pytest.raises(InputError, match="'torch-order9': unknown; did you mean 'torch-order"):
        find_renderer("torch-order9")


def test_names_are_listed_without_loading_anything() -> None:
    code = (
        "import sys; from sfsnet_dr.render.renderers.registry import renderers; assert renderers(); "
        "print([m for m in ('torch', 'mitsuba', 'drjit') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
