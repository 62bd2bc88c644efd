"""The results of a validation summed up: means over lights, the cheapest model within a tolerance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from sfsnet_dr.experiments.validation.measure import NATURAL, LightResult, SceneResults
from sfsnet_dr.experiments.validation.models import ShadingModel, shading_models
from sfsnet_dr.experiments.validation.renderers import RendererResult
from sfsnet_dr.experiments.validation.timing import KernelTime, ModelTime
from sfsnet_dr.report.pareto import TimedError

#: Group of the complete path tracer's points; its error is noise.
PATH: Final = "path tracer"

_GROUPS = {
    "analytic": "SH shading",
    "visibility": "SH + visibility",
    "bounce": "SH + one bounce",
    "gloss": "SH + bounce and gloss",
}


@dataclass(frozen=True)
class Study:
    """Everything that was measured on a scene.

    Attributes:
        scene: errors of the models.
        times: of the models, by key.
        cold: first calls, by key; empty where they were not measured.
        renderers: every registered renderer; empty where none was asked for.
    """

    scene: SceneResults
    times: Mapping[str, ModelTime]
    cold: Mapping[str, KernelTime] = field(default_factory=dict)
    renderers: tuple[RendererResult, ...] = ()

    @property
    def models(self) -> tuple[ShadingModel, ...]:
        """The shading models."""
        return shading_models(self.scene.subject.spec.has_gloss)

    @property
    def natural(self) -> tuple[LightResult, ...]:
        """The results under the natural lights; empty if they were not all among the lights."""
        found = tuple(result for result in self.scene.results if result.light.name in NATURAL)
        return found if len(found) == len(NATURAL) else ()

    def capture_seconds(self, model: ShadingModel) -> float:
        """What a model costs once a subject."""
        return self.scene.inputs.seconds[model.kind]


@dataclass(frozen=True)
class Candidate:
    """A model or the path tracer at a number of paths, over all lights of a run.

    Attributes:
        name: for people.
        seconds: of one image, compiled and warm.
        once: seconds once a subject, before the first image.
        error: the largest relative RMS error under any of the lights.
        light: under which that was.
        path: whether it is the path tracer, whose error is noise.
    """

    name: str
    seconds: float
    once: float
    error: float
    light: str
    path: bool


def pooled_error(study: Study, key: str, results: Iterable[LightResult]) -> TimedError:
    """A model over several lights: RMS of its relative errors, with the RMS of the intervals' ends."""
    model = next(model for model in study.models if model.key == key)
    errors = [result.row(key).errors.rel for result in results]
    low, value, high = (_rms(getattr(e, name) for e in errors) for name in ("low", "value", "high"))
    return TimedError(model.name, _GROUPS[model.kind], study.times[key].warm.total, value, (low, high))


def path_candidates(results: Iterable[LightResult]) -> list[TimedError]:
    """The path tracer over several lights: median time and RMS noise at each number of paths."""
    columns = zip(*(result.paths for result in results), strict=True)
    return [
        TimedError(
            f"{column[0].samples} paths",
            PATH,
            float(np.median([path.seconds for path in column])),
            _rms(path.noise for path in column),
        )
        for column in columns
    ]


def all_candidates(study: Study) -> list[Candidate]:
    """All models and the path tracer, the quickest image first."""
    results = study.scene.results
    found = []
    for model in study.models:
        worst = max(results, key=lambda result: result.row(model.key).errors.rel.value)
        error, once = worst.row(model.key).errors.rel.value, study.capture_seconds(model)
        seconds = study.times[model.key].warm.total
        found.append(Candidate(model.name, seconds, once, error, worst.light.name, path=False))
    for k, path in enumerate(results[0].paths):
        worst = max(results, key=lambda result: result.paths[k].noise)
        seconds = float(np.median([result.paths[k].seconds for result in results]))
        name = f"the path tracer with {path.samples} paths a pixel"
        found.append(Candidate(name, seconds, 0.0, worst.paths[k].noise, worst.light.name, path=True))
    return sorted(found, key=lambda candidate: candidate.seconds)


def cheapest_model(study: Study, tolerance: float) -> Candidate | None:
    """The quickest of the candidates that stay within a tolerance under every light; None if none does."""
    return next((c for c in all_candidates(study) if c.error <= tolerance), None)


def summary_sentence(study: Study, tolerance: float) -> str:
    """What ``cheapest_model`` found, for a reader who knows nothing else."""
    best, scene = cheapest_model(study, tolerance), study.scene.name.replace("_", " ")
    allowed, count = f"{100 * tolerance:g} %", len(study.scene.results)
    lights = "the one light" if count == 1 else f"all {count} lights"
    if best is None:
        near = min(all_candidates(study), key=lambda candidate: candidate.error)
        return (
            f"No model stays within {allowed} on the scene {scene} under {lights}: the nearest is "
            f"{near.name}, with a relative RMS error of {_percent(near.error)} under {near.light}."
        )
    if best.path:
        return (
            f"No shading model stays within {allowed} on the scene {scene} under {lights}; {best.name} does, "
            f"in {format_duration(best.seconds)} an image, with at most {_percent(best.error)} of noise "
            f"({best.light})."
        )
    return (
        f"The cheapest model within {allowed} on the scene {scene} under {lights} is {best.name}: a relative "
        f"RMS error of at most {_percent(best.error)} ({best.light}) in {format_duration(best.seconds)} an "
        f"image, after {format_duration(best.once)} of capture once a subject."
    )


def format_duration(seconds: float) -> str:
    """A time with two digits and the unit that fits."""
    units = (("s", 1.0), ("ms", 1e-3), ("\u00b5s", 1e-6))
    unit, size = next((unit for unit in units if seconds >= 0.995 * unit[1]), units[-1])
    return f"{float(f'{seconds / size:.2g}'):g} {unit}"


def _percent(error: float) -> str:
    return f"{float(f'{100 * error:.2g}'):g} %"


def _rms(values: Iterable[float]) -> float:
    return float(np.sqrt(np.mean(np.square(list(values)))))
