"""Every registered renderer on the same scene: how far it is from the truth, or why it has no image."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from sfsnet_dr.experiments.validation.measure import Errors, LightResult, SceneResults, measure_errors
from sfsnet_dr.experiments.validation.references import IndependentPair
from sfsnet_dr.metrics.noise_free import RelativeRmse, relative_rmse
from sfsnet_dr.render.renderers.base import Budget, Capabilities
from sfsnet_dr.render.renderers.registry import find_renderer, renderers
from sfsnet_dr.render.renderers.sandbox import Outcome, run_sandboxed

#: Paths per pixel of renderers that draw random ones. Their noise is left out of the errors.
SAMPLES: Final = 32

#: The renderer whose distance from the truth without gloss, which it has not either, is what RGB leaves out.
SPECTRAL: Final = "mitsuba-spectral-path"

_SEEDS = (7001, 7002)  # far from those of the references


@dataclass(frozen=True)
class RendererResult:
    """One renderer under one light.

    Attributes:
        renderer: its registered name.
        light: the light's name.
        capabilities: what it says that it accounts for; None if it could not be asked.
        errors: distance from the truth, its own noise left out of ``rel``; None after a failure.
        plain: relative RMS error against the subject without gloss, noise left out; None after a failure.
        noise: relative RMS noise of one image at ``SAMPLES``; 0 for renderers without.
        seconds: of one image, or until it failed.
        failure: one line that says why there is no image; empty if there is one.
    """

    renderer: str
    light: str
    capabilities: Capabilities | None
    errors: Errors | None
    plain: RelativeRmse | None
    noise: float
    seconds: float
    failure: str


def chosen_renderers(names: str) -> tuple[str, ...]:
    """Renderers by ``all``, ``none``, or names with commas between.

    Raises:
        InputError: for a name that nobody has, with the nearest known one.
    """
    if names in ("all", "none"):
        return tuple(renderers()) if names == "all" else ()
    asked = tuple(name.strip() for name in names.split(","))
    for name in asked:
        if name not in renderers():
            find_renderer(name)  # tells the nearest name
    return asked


def compare_renderers(
    measured: SceneResults,
    lights: Mapping[str, Sequence[LightResult]],
    on_image: Callable[[str], None] = lambda name: None,
) -> tuple[RendererResult, ...]:
    """Measure every renderer under its lights.

    Args:
        measured: the subject and the pixels that count.
        lights: by the name of each renderer, the lights with their path-traced images.
        on_image: called with a renderer's name after each light.
    """
    found = []
    for name, results in lights.items():
        gave_up = None
        for result in results:
            light = result.light.name
            other = replace(gave_up, light=light) if gave_up else _measure(measured, name, result)
            found.append(other)
            # What is not installed or hung will not do better under the next light.
            gave_up = other if other.failure else None
            on_image(name)
    return tuple(found)


def _measure(measured: SceneResults, name: str, result: LightResult) -> RendererResult:
    first = run_sandboxed(name, measured.subject, result.light, Budget(SAMPLES, _SEEDS[0]))
    noisy = first.capabilities is not None and first.capabilities.noisy
    second = first
    if noisy and first.image is not None:
        second = run_sandboxed(name, measured.subject, result.light, Budget(SAMPLES, _SEEDS[1]))
    failed = next((outcome for outcome in (first, second) if outcome.image is None), None)
    if failed is not None:
        return _failed(failed, result.light.name)
    pair = IndependentPair(
        np.asarray(first.image, dtype=np.float64), np.asarray(second.image, dtype=np.float64)
    )
    mask, truth = measured.inputs.mask, result.truth
    power = float(((truth.first * truth.second) * mask[..., None]).sum())
    noise = float((((pair.first - pair.second) ** 2) * mask[..., None]).sum() / 2)
    return RendererResult(
        renderer=name,
        light=result.light.name,
        capabilities=first.capabilities,
        errors=measure_errors(pair, truth, mask),
        plain=relative_rmse(pair.first, *result.plain, mask, again=pair.second),
        noise=float(np.sqrt(noise / power)),
        seconds=min(first.seconds, second.seconds),
        failure="",
    )


def _failed(outcome: Outcome, light: str) -> RendererResult:
    return RendererResult(
        outcome.renderer, light, outcome.capabilities, None, None, 0.0, outcome.seconds, _why(outcome)
    )


def _why(outcome: Outcome) -> str:
    failure = outcome.failure
    if failure is None:
        return "no image"
    return failure.detail if failure.kind == "not installed" else str(failure)


def spectral_size(compared: Sequence[RendererResult], light: str) -> float | None:
    """Relative RMS change by spectra in place of RGB under a light; None where it was not measured."""
    found = (r.plain.value for r in compared if r.renderer == SPECTRAL and r.light == light and r.plain)
    return next(found, None)
