"""Path tracers in processes of their own against the one in this process, with the noise of both counted."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.bowls import bowl_and_ball
from numpy.typing import NDArray

from sfsnet_dr.core.errors import InputError, NotInstalled
from sfsnet_dr.metrics.equivalence import Estimate, check_agreement, estimate_from_seeds
from sfsnet_dr.render.renderers.base import Budget
from sfsnet_dr.render.renderers.registry import find_renderer
from sfsnet_dr.render.renderers.remote import cycles_python
from sfsnet_dr.scene.lights.light import Light, direction_from_angles
from sfsnet_dr.scene.mesh import sphere_mesh
from sfsnet_dr.scene.spec import CameraSpec, SceneSpec
from sfsnet_dr.scene.subject import Subject
from sfsnet_dr.sh.projection import equirect_directions

SIZE, SEEDS = 24, 6

#: Chance that a test of this file fails though all is well.
LEVEL = 1e-4


def installed() -> bool:
    try:
        return cycles_python().is_file()
    except NotInstalled:
        return False


CYCLES = pytest.mark.skipif(not installed(), reason="Cycles is not installed: make cycles")
TRACERS = [
    pytest.param("mitsuba-scalar", 64),
    pytest.param("cycles", 16, marks=CYCLES),  # its Sobol points need fewer
]


def hollow() -> Subject:
    """A coloured ball in a coloured bowl: shadows, light between surfaces, and no symmetry."""
    camera = CameraSpec(size=SIZE)
    return Subject(
        SceneSpec("bowl_and_ball", "sphere", camera=camera, gloss=False), 0, bowl_and_ball(), camera
    )


def oblique_sky(tint: tuple[float, float, float] = (1.0, 0.8, 0.5)) -> Light:
    """A bright spot on a dim sky, off every axis, and high enough that the map's rows matter."""
    spot = np.maximum(equirect_directions(64, 128) @ direction_from_angles(50, 40), 0)[..., None] ** 8
    return Light("oblique", (0.2 + 2.0 * spot) * np.array(tint))


def all_at_once() -> Light:
    """The sky and two suns of two colours, from three sides."""
    lamps = (
        (direction_from_angles(40, 30), np.array([2.0, 1.5, 1.0])),
        (direction_from_angles(-60, -10), np.array([0.2, 0.5, 0.9])),
    )
    return Light("all", oblique_sky().environment, lamps)


def estimate(name: str, light: Light, samples: int, subject: Subject | None = None) -> Estimate:
    renderer, where = find_renderer(name), subject or hollow()
    return estimate_from_seeds(
        [renderer.render(where, light, Budget(samples, seed)) for seed in range(SEEDS)]
    )


@cache
def here(depth: str) -> Estimate:
    """What they are held against."""
    return estimate(f"mitsuba-llvm-{depth}", all_at_once(), 256)


@pytest.mark.parametrize(("tracer", "samples"), TRACERS)
@pytest.mark.parametrize(
    "depth",
    [pytest.param("direct", marks=pytest.mark.slow), pytest.param("bounce", marks=pytest.mark.slow), "path"],
)
def test_it_agrees_with_the_path_tracer_here(tracer: str, samples: int, depth: str) -> None:
    found = check_agreement(estimate(f"{tracer}-{depth}", all_at_once(), samples), here(depth))
    assert found.p > LEVEL, found.worst


@pytest.mark.slow
@pytest.mark.parametrize(("tracer", "samples"), TRACERS)
def test_small_defects_would_be_seen(tracer: str, samples: int) -> None:
    subject, light = hollow(), all_at_once()
    assert light.environment is not None
    darker = replace(subject, mesh=replace(subject.mesh, albedo=0.97 * subject.mesh.albedo))
    turned = replace(light, environment=np.roll(light.environment, 2, axis=1))  # 5.6 degrees
    for defect in (
        estimate(f"{tracer}-path", light, samples, darker),
        estimate(f"{tracer}-bounce", light, samples),
        estimate(f"{tracer}-path", turned, samples),
    ):
        assert check_agreement(defect, here("path")).p < LEVEL


@CYCLES
def test_cycles_agrees_where_shading_normals_face_away_from_the_viewer() -> None:
    """A ball whose normals are pulled back: its rim faces away, and Cycles by itself shades it too."""
    ball = hollow()
    tilted = sphere_mesh().normals + np.array([0.0, 0.0, -0.6])
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    ball = replace(ball, mesh=replace(sphere_mesh(), normals=tilted))
    light = Light("right", None, ((direction_from_angles(60, 0), np.ones(3)),))
    names = ("cycles-direct", "mitsuba-llvm-direct")
    ours, theirs = (find_renderer(name).render(ball, light, Budget(256, 0)) for name in names)
    assert (theirs[10:14, 21:23] == 0).all()  # the rim at the right, towards the light
    # 256 points of a pixel in two samplers: edges of what is lit differ by 3 % of 0.2 at most.
    np.testing.assert_allclose(ours, theirs, atol=0.01)


def relative(image: NDArray[np.floating], reference: NDArray[np.floating]) -> NDArray[np.float64]:
    """Difference of the means of each colour, relative."""
    return np.asarray(image.mean(axis=(0, 1)) / reference.mean(axis=(0, 1)) - 1.0, dtype=np.float64)


@pytest.mark.slow
def test_spectra_differ_from_colours_only_where_coloured_light_meets_coloured_skin() -> None:
    # A product of two smooth spectra has not the product of their colours; what it has depends on how the
    # spectra were made of colours (Jakob and Hanika 2019). Measured, with 0.1 % of noise: 0.4 % in white
    # light, 1.3 % in coloured light. (Light that met two coloured surfaces differs by 1.4 % though it was
    # white.)
    for tint, low, high in (((1.0, 1.0, 1.0), 0.0, 0.008), ((1.0, 0.8, 0.5), 0.008, 0.03)):
        light = oblique_sky(tint)
        spectral, colours = (estimate(f"mitsuba-{kind}-direct", light, 128) for kind in ("spectral", "llvm"))
        difference = np.abs(relative(spectral.mean, colours.mean)).max()
        assert low <= difference < high


@pytest.mark.parametrize("tracer", ["mitsuba-scalar", pytest.param("cycles", marks=CYCLES)])
def test_a_seed_is_one_image_and_two_seeds_are_two(tracer: str) -> None:
    renderer = find_renderer(f"{tracer}-direct")
    first, again, other = (
        renderer.render(hollow(), oblique_sky(), Budget(samples=4, seed=seed)) for seed in (1, 1, 2)
    )
    assert first.dtype == np.float32
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_without_cycles_the_command_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SFSNET_DR_CYCLES_PYTHON", "/nowhere/python")
    with pytest.raises(InputError, match=r"cycles: not installed \(.*\): make cycles$"):
        find_renderer("cycles-direct").render(hollow(), all_at_once(), Budget())
