"""Rates, not values: how errors fall with the model's order and with the number of samples; and energy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from helpers.bowls import bowl_and_ball
from numpy.typing import NDArray

from sfsnet_dr.render.aovs import TransportOptions, render_aovs
from sfsnet_dr.render.path_tracer import path_trace
from sfsnet_dr.render.renderers.base import Budget
from sfsnet_dr.render.renderers.registry import find_renderer
from sfsnet_dr.render.sobol import Sampler
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.mesh import SHAPES, sphere_mesh
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.spec import CameraSpec, SamplingSpec, SceneSpec
from sfsnet_dr.scene.subject import Subject
from sfsnet_dr.sh.icosphere import icosphere

Array = NDArray[np.float64]
Image = NDArray[np.floating]

SMALL, TINY = CameraSpec(size=24), CameraSpec(size=12)

#: Order of the light: RMS and mean absolute error over the sphere under one directional light of irradiance
#: pi (Ramamoorthi and Hanrahan 2001; Basri and Jacobs 2003). The third band of the cosine is 0.
TABLE = {
    0: (0.3227, 0.2813),
    1: (0.1443, 0.1250),
    2: (0.03608, 0.03067),
    3: (0.03608, 0.03067),
    4: (0.01804, 0.01483),
}
#: Transport knows shadows and light between surfaces too, of which a ball has none.
MODELS = {order: [f"{form}-order{order}" for form in ("numpy", "torch", "drjit")] for order in TABLE}
MODELS[2] += ["numpy-order2-visibility", "drjit-order2-visibility"]
MODELS[4] += ["drjit-order4-visibility", "drjit-order4-bounce"]


@cache
def ball() -> Subject:
    spec = SceneSpec("ball", "sphere", sampling=SamplingSpec(spp=64, paths_per_hit=1))
    return Subject(spec, 0, sphere_mesh(), CameraSpec(size=48))


@cache
def lamps() -> list[Light]:
    """42 directions over the whole sphere. One lamp an image: the path tracer picks one, which is noise."""
    return [Light("lamp", None, ((toward, np.full(3, np.pi)),)) for toward in icosphere(1)]


@cache
def traced_ball() -> tuple[Array, NDArray[np.bool_]]:
    """The ball under each of the lamps by the path tracer, (42, H, W, 3), and the pixels that it fills."""
    scene = SurfaceScene(ball().mesh, ball().camera, lamps()[0].directional)
    images = []
    for light in lamps():
        scene.set_directional(light.directional)
        images.append(path_trace(scene, 32, 0, depth=2).mean)
    return np.array(images), render_aovs(scene, 64, 0).coverage == 1


@pytest.mark.parametrize(("order", "name"), [(order, name) for order in MODELS for name in MODELS[order]])
def test_errors_fall_with_the_order_as_the_exact_table_says(order: int, name: str) -> None:
    """From mesh to image: over all directions of the light, each normal has the whole sphere's errors."""
    reference, inside = traced_ball()
    renderer = find_renderer(name)
    images = np.array([renderer.render(ball(), light, Budget()) for light in lamps()])
    error = (images - reference)[:, inside] / 0.5
    rms, mean = TABLE[order]
    # 42 directions for all, and edges of light that a pixel averages: 0.45 % seen at order 4, times 2.
    assert np.sqrt((error**2).mean()) == pytest.approx(rms, rel=0.009)
    assert np.abs(error).mean() == pytest.approx(mean, rel=0.009)


@dataclass(frozen=True)
class Fit:
    """Errors that go as N to some power, with the half-width of its 99.7 % interval."""

    power: float
    width: float


def fitted(samples: Sequence[int], errors: Array) -> Fit:
    """Straight line through (len(samples), repeats) errors in the logarithms, by least squares."""
    x = np.repeat(np.log(samples), errors.shape[1])
    y = np.log(errors).ravel()
    x = x - x.mean()
    power = float(x @ y / (x @ x))
    rest = y - y.mean() - power * x
    return Fit(power, float(3 * np.sqrt(rest @ rest / (len(y) - 2) / (x @ x))))


@cache
def hollow() -> SurfaceScene:
    """A bowl with a ball in it, in a sky that is brighter to one side and above."""
    scene = SurfaceScene(bowl_and_ball(), TINY)
    scene.set_environment(np.outer(np.linspace(2.0, 0.2, 64), np.linspace(0.2, 2.0, 128) ** 2)[..., None])
    return scene


def errors_of(
    render: Callable[[int, int], Image], samples: Sequence[int], repeats: int, truth: Image
) -> Array:
    """(len(samples), repeats) RMS errors against a truth whose own noise is far smaller."""
    return np.array(
        [
            [np.sqrt(np.mean((render(count, 100 * n + k) - truth) ** 2)) for k in range(repeats)]
            for n, count in enumerate(samples)
        ]
    )


def test_the_path_tracers_error_falls_as_one_over_the_root_of_the_samples() -> None:
    samples = (4, 16, 64, 256)
    truth = path_trace(hollow(), 8192, 999).mean  # its noise adds 1.6 % to the error of 256 samples

    def render(count: int, seed: int) -> Image:
        return path_trace(hollow(), count, seed).mean

    fit = fitted(samples, errors_of(render, samples, 4, truth))
    assert abs(fit.power + 0.5) < fit.width
    assert fit.width < 0.05
    # What this finds: a bias of 5 %, which more samples do not mend.
    biased = fitted(samples, errors_of(render, samples, 3, 1.05 * truth))
    assert biased.power > -0.5 + biased.width


@pytest.mark.parametrize(
    "sampler",
    [
        "independent",
        "sobol",
        pytest.param("stratified", marks=pytest.mark.slow),
        pytest.param("r4", marks=pytest.mark.slow),
    ],
)
def test_noise_of_transport_falls_at_least_as_fast(sampler: Sampler) -> None:
    """Light seen directly, where points of low discrepancy help; independent ones give the root law."""
    samples = (4, 16, 64, 256)
    options = TransportOptions(order=1, sampler=sampler)

    def render(count: int, seed: int) -> Image:
        return render_aovs(hollow(), count, seed, options).transport

    truth = render(4096, 999)
    fit = fitted(samples, errors_of(render, samples, 3, truth))
    assert fit.width < 0.08
    if sampler == "independent":
        assert abs(fit.power + 0.5) < fit.width
    else:
        assert fit.power < -0.5 + fit.width
    if sampler in ("stratified", "sobol"):  # edges of shadows bring others' rate back to the root law
        assert fit.power < -0.5 - fit.width


def test_noise_of_transport_with_bounces_falls_at_least_as_fast() -> None:
    """Further points of a path have independent numbers: the root law in the end, and never slower."""
    samples = (4, 16, 64)
    options = TransportOptions(order=1, bounces=3, paths=2)

    def render(count: int, seed: int) -> Image:
        return render_aovs(hollow(), count, seed, options).transport

    truth = render(2048, 999)
    fit = fitted(samples, errors_of(render, samples, 3, truth))
    assert fit.power < -0.5 + fit.width
    assert fit.width < 0.1


@pytest.mark.parametrize("shape", SHAPES)
def test_no_scene_reflects_more_than_it_gets(shape: str) -> None:
    """White surfaces in a white sky of radiance 1 are 1 everywhere: nothing is lost between them, or made.

    By reciprocity a pixel in that sky is the share of the light from the camera's side that is reflected into
    all directions, so that this is the conservation of energy itself.
    """
    scene = SurfaceScene(SHAPES[shape]((1.0, 1.0, 1.0)), SMALL)
    scene.set_environment(1.0)
    image = path_trace(scene, 256, 0)
    maps = render_aovs(scene, 64, 0, TransportOptions(order=0, bounces=12, paths=4))
    inside = maps.coverage == 1
    # The interpolated normals of facets lean off them by up to half their angle to the next: a share of light
    # from below the facet is lost, 0.1 % seen on the spheres, times 2; nothing may be gained beyond noise.
    noise = np.sqrt(image.variance[inside].sum()) / image.mean[inside].size
    assert 1 - 2e-3 - 4.5 * noise < image.mean[inside].mean() < 1 + 4.5 * noise
    assert (image.mean - 1 < 6 * np.sqrt(image.variance) + 1e-5)[inside].all()
    furnace = maps.transport[0][inside] * np.sqrt(4 * np.pi)
    # Twelve further points leave 2^-13 of the light in the bowl, which half of all paths leave at each.
    assert 1 - 3e-3 < furnace.mean() < 1 + 2e-3
    assert 1.02 * image.mean[inside].mean() > 1 + 4.5 * noise  # two per cent too much would be seen
