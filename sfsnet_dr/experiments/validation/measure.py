"""How wrong each model is on a subject under many lights, why, and how fast the path tracer catches up."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.color import delta_e_2000
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.experiments.validation.error_sources import Cause, ErrorPart, ErrorStep, decompose_error
from sfsnet_dr.experiments.validation.models import ModelInputs, ShadingModel, capture_inputs, shading_models
from sfsnet_dr.experiments.validation.references import (
    FineMaps,
    IndependentPair,
    LightPathImages,
    trace_light_paths,
)
from sfsnet_dr.metrics.image import flip_metric, has_flip, mae_8bit
from sfsnet_dr.metrics.noise_free import RelativeRmse, relative_rmse, worst_block
from sfsnet_dr.render.path_tracer import path_trace
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.lights.presets import require_light
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.scene_cache import SceneCache
from sfsnet_dr.scene.subject import Subject

Image = npt.NDArray[np.float64]

#: Paths per pixel at which the path tracer is timed.
PATH_SAMPLES: Final = (4, 16, 64, 256)

#: The lights over which a model's mean error is given: as photographs are lit, and always the same.
NATURAL: Final = ("natural0", "natural1", "natural2")


@dataclass(frozen=True)
class Errors:
    """Distances of an image from the truth, on the mask.

    Attributes:
        rel: relative RMS error with interval, free of noise.
        worst: the same of the worst 8 x 8 block, over the RMS of the whole truth.
        mae_8bit: mean absolute difference in 8-bit sRGB units; holds the noise of the reference.
        delta_e: mean CIE Delta E 2000; likewise.
        flip: mean FLIP; likewise. None where ``flip-evaluator`` is not installed.
    """

    rel: RelativeRmse
    worst: float
    mae_8bit: float
    delta_e: float
    flip: float | None


@dataclass(frozen=True)
class Row:
    """One model under one light.

    Attributes:
        name: such as ``order 2``, for people.
        key: such as ``order2``, for records.
        group: model's kind, or ``path`` for a path tracer that leaves something out.
        errors: distance from the truth.
        parts: the error split by cause.
        image: (H, W, 3) linear.
    """

    name: str
    key: str
    group: str
    errors: Errors
    parts: dict[Cause, ErrorPart]
    image: Image


@dataclass(frozen=True)
class PathTime:
    """The path tracer at some paths a pixel: wall time of an image, compiled, and relative RMS noise."""

    samples: int
    seconds: float
    noise: float


@dataclass(frozen=True)
class LightResult:
    """All models under one light.

    Attributes:
        light: the light.
        rows: models, cheapest first, then path tracers that leave something out.
        paths: the complete path tracer, by samples.
        truth: the two references.
        plain: the same of the subject without its gloss.
        floor: distance of one reference from the other: what noise adds to the errors that hold it.
        variance: of one path's radiance, mean over mask and colours.
    """

    light: Light
    rows: tuple[Row, ...]
    paths: tuple[PathTime, ...]
    truth: IndependentPair
    plain: IndependentPair
    floor: Errors
    variance: float

    @property
    def hard(self) -> bool:
        """Whether a lamp or sun casts hard shadows."""
        return bool(self.light.directional)

    def row(self, key: str) -> Row:
        """The row of a key."""
        return next(row for row in self.rows if row.key == key)

    def crossover(self, key: str) -> float:
        """Paths per pixel N* from which the path tracer is more accurate than a model: variance / bias^2."""
        bias = self.row(key).errors.rel.bias_squared
        return self.variance / bias if bias > 0 else float("inf")


@dataclass(frozen=True)
class SceneResults:
    """A subject's results: what the models know of it, and one result for each light."""

    subject: Subject
    inputs: ModelInputs
    results: tuple[LightResult, ...]

    @property
    def name(self) -> str:
        """Of the scene."""
        return self.subject.spec.name


def measure_models(
    subject: Subject,
    lights: Sequence[Light],
    *,
    samples: int | None = None,
    seed: int = 0,
    on_light: Callable[[str], None] = lambda name: None,
) -> SceneResults:
    """Measure every model of the measured.

    Args:
        subject: what is seen.
        lights: under which.
        samples: paths per pixel of each of the two references; the scene says if not given.
        seed: of all noise.
        on_light: called with a light's name when it is done.

    Raises:
        InputError: for a light of all zeros, no light, or a subject of which the camera sees nothing.
    """
    if not lights:
        raise InputError("lights: none found, at least one expected")
    for light in lights:
        require_light(light)
    models = shading_models(subject.spec.has_gloss)
    known = capture_inputs(subject, seed, models)
    if not known.mask.any():
        raise InputError(
            f"{subject.spec.name}: no surface in view: no pixel is covered whole by what is counted"
        )
    scenes, fine = SceneCache(), FineMaps.of(subject, known.mask, seed)
    samples = subject.spec.sampling.reference_spp if samples is None else samples
    results = []
    for light in lights:
        levels = trace_light_paths(scenes, subject, light, samples, seed)
        scene = scenes.show(subject.mesh, subject.camera, light, gloss=subject.spec.has_gloss)
        results.append(_measure(light, levels, known, fine, models, partial(_path_times, scene, seed)))
        on_light(light.name)
    return SceneResults(subject, known, tuple(results))


def measure_errors(image: IndependentPair, truth: IndependentPair, mask: Image) -> Errors:
    """All distances of an image, or of two that differ by noise, from the truth."""
    shown, reference = image.mean, truth.mean
    counted = mask > 0
    return Errors(
        rel=relative_rmse(image.first, *truth, mask, again=image.second),
        worst=worst_block(shown, *truth, mask),
        mae_8bit=mae_8bit(shown, reference, mask),
        delta_e=float(delta_e_2000(np.clip(shown[counted], 0, 1), np.clip(reference[counted], 0, 1)).mean()),
        flip=flip_metric(shown, reference, mask) if has_flip() else None,
    )


def _measure(
    light: Light,
    levels: LightPathImages,
    known: ModelInputs,
    fine: FineMaps,
    models: tuple[ShadingModel, ...],
    times: Callable[[float], tuple[PathTime, ...]],
) -> LightResult:
    complete = _twice(fine.complete(light))
    rows = []
    for model in models:
        image = known.image(model, light)
        steps = _steps(model, _twice(image), light, levels, fine, complete)
        parts = decompose_error(steps, known.mask, known.noise(model, light))
        errors = measure_errors(_twice(image), levels.truth, known.mask)
        rows.append(Row(model.name, model.key, model.kind, errors, parts, image))
    rows += [_limit(name, key, steps, levels, known.mask) for name, key, steps in _limits(levels)]
    variance = _mean(levels.variance, known.mask)
    power = _mean(levels.truth.first * levels.truth.second, known.mask)
    return LightResult(
        light=light,
        rows=tuple(rows),
        paths=times(variance / power),
        truth=levels.truth,
        plain=levels.diffuse,
        floor=measure_errors(_twice(levels.truth.first), _twice(levels.truth.second), known.mask),
        variance=variance,
    )


def _steps(
    model: ShadingModel,
    image: IndependentPair,
    light: Light,
    levels: LightPathImages,
    fine: FineMaps,
    complete: IndependentPair,
) -> list[ErrorStep]:
    """From a model's image to the truth; see ``study.causes``."""
    further = _after_direct(levels)
    if model.kind == "visibility":
        return [ErrorStep("truncation", image, levels.direct), *further]
    if model.kind == "bounce":
        return [ErrorStep("truncation", image, levels.bounce), *_after_bounce(levels)]
    if model.kind == "gloss" and levels.glossy_bounce is not None:
        rest = ErrorStep("interreflection", levels.glossy_bounce, levels.truth)
        return [ErrorStep("truncation", image, levels.glossy_bounce), rest]
    truncated = _twice(fine.truncated(light, model.order))
    return [
        ErrorStep("filter", image, truncated),
        ErrorStep("truncation", truncated, complete),
        ErrorStep("visibility", complete, levels.direct),
        *further,
    ]


def _after_direct(levels: LightPathImages) -> list[ErrorStep]:
    return [ErrorStep("interreflection", levels.direct, levels.diffuse), *_gloss(levels)]


def _after_bounce(levels: LightPathImages) -> list[ErrorStep]:
    return [ErrorStep("interreflection", levels.bounce, levels.diffuse), *_gloss(levels)]


def _gloss(levels: LightPathImages) -> list[ErrorStep]:
    return [] if levels.glossy_bounce is None else [ErrorStep("gloss", levels.diffuse, levels.truth)]


def _limits(levels: LightPathImages) -> list[tuple[str, str, list[ErrorStep]]]:
    """Path tracers that leave something out, without their noise: what no cheaper model can beat."""
    found = [
        ("path traced, direct light", "path_direct", _after_direct(levels)),
        ("path traced, one bounce", "path_bounce", _after_bounce(levels)),
    ]
    return [
        *found,
        *([("path traced, no gloss", "path_diffuse", gloss)] if (gloss := _gloss(levels)) else []),
    ]


def _limit(name: str, key: str, steps: list[ErrorStep], levels: LightPathImages, mask: Image) -> Row:
    image = steps[0].upper
    return Row(
        name, key, "path", measure_errors(image, levels.truth, mask), decompose_error(steps, mask), image.mean
    )


def _path_times(scene: SurfaceScene, seed: int, variance: float) -> tuple[PathTime, ...]:
    found = []
    for samples in PATH_SAMPLES:
        begin = time.perf_counter()
        path_trace(scene, samples, seed)
        found.append(PathTime(samples, time.perf_counter() - begin, float(np.sqrt(variance / samples))))
    return tuple(found)


def _twice(image: Image) -> IndependentPair:
    return IndependentPair(image, image)


def _mean(values: Image, mask: Image) -> float:
    return float((values * mask[..., None]).sum() / (3 * mask.sum()))
