"""How wrong each shading model is on a scene, and how long it takes, against the path tracer."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import torch

from sfsnet_dr.base.conventions import LIGHT_ORDER
from sfsnet_dr.data.relight import relight
from sfsnet_dr.render import shading_drjit
from sfsnet_dr.render.capture import Capture, capture
from sfsnet_dr.render.compare import RelativeRmse, relative_rmse
from sfsnet_dr.render.reference import Reference, path_trace
from sfsnet_dr.scene.mitsuba_scene import ENVIRONMENT_SIZE, SurfaceScene
from sfsnet_dr.scene.spec import FACE_SHAPES, SceneSpec
from sfsnet_dr.scene.subject import build_subject
from sfsnet_dr.sh.coefficients import Radiance
from sfsnet_dr.sh.priors import LobeLight, sample_lights
from sfsnet_dr.sh.projection import project_directional

Image = npt.NDArray[np.float64]
T = TypeVar("T")

#: Orders of the analytic rungs; order 3 equals 2, for the clamped cosine has no third band.
ORDERS = (0, 1, 2, 4)
#: Samples per pixel at which the path tracer is timed, beside the reference itself.
PATH_SAMPLES = (4, 16, 64)
NATURAL_LIGHTS = 3
_LIGHT_SEED = 20
#: From the upper right, 45 degrees from the viewing direction; irradiance pi gives shading 1 at the peak.
HARD_LIGHT = (np.array([0.5, 0.5, np.sqrt(0.5)]), np.full(3, np.pi))


@dataclass(frozen=True)
class Light:
    """A light of the study: an environment, or one directional light where that is None."""

    name: str
    environment: LobeLight | None

    def coefficients(self, order: int) -> Radiance:
        """Radiance coefficients to an order."""
        if self.environment is None:
            return project_directional(*HARD_LIGHT, order)
        return self.environment.coefficients(order)


@dataclass(frozen=True)
class Rung:
    """One model under one light.

    Attributes:
        name: such as ``order 2``.
        group: ``analytic``, ``visibility`` or ``path tracer``.
        seconds: wall time of one image, compiled and warm.
        error: relative RMS error; for the path tracer its noise.
        image: (H, W, 3) linear, or None for the path tracer.
    """

    name: str
    group: str
    seconds: float
    error: RelativeRmse
    image: Image | None = None


@dataclass(frozen=True)
class LightResult:
    """All rungs under one light, with the reference.

    Attributes:
        light: the light.
        rungs: the models, cheapest first.
        reference: (H, W, 3) mean of both references.
        variance_of_one_sample: mean over mask and colours; the path tracer's squared error is this / N.
    """

    light: Light
    rungs: tuple[Rung, ...]
    reference: Image
    variance_of_one_sample: float

    def rung(self, name: str) -> Rung:
        """The rung of a name."""
        return next(rung for rung in self.rungs if rung.name == name)

    def crossover(self, name: str) -> float:
        """Samples per pixel N* from which the path tracer is more accurate than a rung: variance / bias^2."""
        bias = self.rung(name).error.bias_squared
        return self.variance_of_one_sample / bias if bias > 0 else float("inf")


@dataclass(frozen=True)
class Ladder:
    """A scene's results.

    Attributes:
        spec: the scene.
        mask: (H, W) pixels that are counted.
        capture_seconds: one-off time of maps and transport, warm.
        results: one for each light.
    """

    spec: SceneSpec
    mask: Image
    capture_seconds: float
    results: tuple[LightResult, ...]


def climb(spec: SceneSpec, seed: int = 0, on_light: Callable[[str], None] = lambda name: None) -> Ladder:
    """Measure every rung on a scene under three natural environments and one hard light.

    Args:
        spec: the scene; its sampling says how many paths each of the two references gets.
        seed: of the head and of the references' noise.
        on_light: called with a light's name when it is done.
    """
    subject = build_subject(spec, seed)
    surface, camera = subject.mesh, subject.camera
    soft, hard = SurfaceScene(surface, camera), SurfaceScene(surface, camera, (HARD_LIGHT,))
    capture(soft, 1, seed)  # compiles
    maps, capture_seconds = _timed(lambda: capture(soft, spec.sampling.transport, seed), repeats=1)
    mask = (maps.mask if spec.shape in FACE_SHAPES else maps.coverage >= 1.0).astype(np.float64)
    results = []
    for light in study_lights():
        scene = hard if light.environment is None else soft
        if light.environment is not None:
            scene.set_environment(light.environment.equirect(*ENVIRONMENT_SIZE))
        results.append(_measure(light, scene, spec, maps, mask, seed))
        on_light(light.name)
    return Ladder(spec, mask, capture_seconds, tuple(results))


def study_lights() -> list[Light]:
    """The lights that every scene is measured under."""
    natural = sample_lights(np.random.default_rng(_LIGHT_SEED), NATURAL_LIGHTS)
    return [Light(f"natural{k}", light) for k, light in enumerate(natural)] + [Light("directional45", None)]


def _measure(
    light: Light, scene: SurfaceScene, spec: SceneSpec, maps: Capture, mask: Image, seed: int
) -> LightResult:
    paths, depth = spec.sampling.reference, spec.sampling.depth
    path_trace(scene, PATH_SAMPLES[0], 0, depth)  # compiles, if anything is left to compile
    first, seconds = _timed(lambda: path_trace(scene, paths, 2 * seed, depth), repeats=1)
    second = path_trace(scene, paths, 2 * seed + 1, depth)
    rungs = [_analytic(light, order, maps, first, second, mask) for order in ORDERS]
    rungs.append(_with_visibility(light, maps, first, second, mask))
    variance = _masked_mean((first.variance + second.variance) * (paths / 2), mask)
    power = _masked_mean(first.mean * second.mean, mask)
    timings = {
        n: _timed(lambda n=n: path_trace(scene, n, 1, depth), repeats=1)[1]  # type: ignore[misc]
        for n in PATH_SAMPLES
    }
    rungs += [_path_tracer(n, t, variance, power) for n, t in (timings | {paths: seconds}).items()]
    return LightResult(light, tuple(rungs), (first.mean + second.mean) / 2, variance)


def _analytic(
    light: Light, order: int, maps: Capture, first: Reference, second: Reference, mask: Image
) -> Rung:
    normal, albedo = _tensor(maps.normal), _tensor(maps.albedo)
    flat = light.coefficients(order).to_shading().flat()
    shading = torch.from_numpy(flat[None].astype(np.float32))
    shading_drjit.f_render(normal, albedo, shading)  # compiles
    image, seconds = _timed(lambda: shading_drjit.f_render(normal, albedo, shading), repeats=30)
    pixels = np.moveaxis(image[0].numpy().astype(np.float64), 0, -1)
    error = relative_rmse(pixels, first.mean, second.mean, mask)
    return Rung(f"order {order}", "analytic", seconds, error, pixels)


def _with_visibility(light: Light, maps: Capture, first: Reference, second: Reference, mask: Image) -> Rung:
    coefficients = light.coefficients(LIGHT_ORDER)
    image, seconds = _timed(lambda: relight(maps.transport, coefficients), repeats=30)
    error = relative_rmse(image, first.mean, second.mean, mask)
    return Rung("order 2 + visibility", "visibility", seconds, error, np.asarray(image, dtype=np.float64))


def _path_tracer(count: int, seconds: float, variance: float, power: float) -> Rung:
    noise = float(np.sqrt(variance / count / power))
    return Rung(f"{count} spp", "path tracer", seconds, RelativeRmse(noise, noise, noise, variance / count))


def _timed(work: Callable[[], T], repeats: int) -> tuple[T, float]:
    """The last result and the median wall time; the work must end with its values in memory."""
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        result = work()
        seconds.append(time.perf_counter() - begin)
    return result, float(np.median(seconds))


def _masked_mean(values: Image, mask: Image) -> float:
    return float((values * mask[..., None]).sum() / (3 * mask.sum()))


def _tensor(image: npt.NDArray[np.float32]) -> torch.Tensor:
    return torch.from_numpy(np.moveaxis(image, -1, 0)[None].copy())
