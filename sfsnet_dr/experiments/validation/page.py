"""The page of a validation: tables, plots and error maps."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.visualize import on_white, png_bytes, show_linear
from sfsnet_dr.experiments.validation.error_sources import CAUSES
from sfsnet_dr.experiments.validation.measure import LightResult
from sfsnet_dr.experiments.validation.renderers import SAMPLES, RendererResult, spectral_size
from sfsnet_dr.experiments.validation.summary import (
    Study,
    format_duration,
    path_candidates,
    pooled_error,
    summary_sentence,
)
from sfsnet_dr.metrics.image import INSTALL
from sfsnet_dr.render.renderers.base import Capabilities
from sfsnet_dr.render.renderers.registry import is_built_in
from sfsnet_dr.report.html import Block, Figure, Gallery, KeyNumbers, Section, Table, write_page
from sfsnet_dr.report.pareto import TimedError, pareto_plot
from sfsnet_dr.report.plots import error_map, signed_colours
from sfsnet_dr.report.record import Record
from sfsnet_dr.scene.lights.presets import describe_light

_PATH_ROWS = "path_"


def models_table(study: Study) -> Table:
    """Relative errors: models by lights, with time and crossover."""
    results = study.scene.results
    rows = []
    for row in results[0].rows:
        cells = [format_percent(result.row(row.key).errors.rel.value) for result in results]
        timed = row.key in study.times
        natural = (
            [_interval(pooled_error(study, row.key, study.natural)) if timed else ""] if study.natural else []
        )
        time = format_duration(study.times[row.key].warm.total) if timed else "\u2013"
        rows.append([_unbroken(row.name), time, _crossover(study, row.key), *natural, *cells])
    for k, path in enumerate(results[0].paths):
        cells = [format_percent(result.paths[k].noise) for result in results]
        seconds = float(np.median([result.paths[k].seconds for result in results]))
        natural = [""] if study.natural else []
        rows.append(
            [_unbroken(f"{path.samples} paths (noise)"), format_duration(seconds), "", *natural, *cells]
        )
    mean = ["natural (interval)"] if study.natural else []
    return Table(
        ["model", "time", "N*", *mean, *(result.light.name for result in results)],
        rows,
        "Relative RMS errors. The interval (95 %) is over blocks of pixels. Rows that begin with `path "
        "traced` are the path tracer with something left out and without its noise: no cheaper model of "
        "that kind can do better. N* is the number of paths a pixel from which the complete path tracer is "
        "more accurate, the median over the lights. Order 3 equals order 2 because a cosine has no third "
        "band.",
    )


def causes_table(study: Study, key: str) -> Table:
    """A model's error by cause: the change that each makes, and its part of the squared error."""
    rows = []
    for result in study.scene.results:
        parts = result.row(key).parts
        cells = [f"{format_percent(parts[cause].size)} ({100 * parts[cause].share:.0f})" for cause in CAUSES]
        spectral = spectral_size(study.renderers, result.light.name)
        rows.append(
            [
                result.light.name,
                format_percent(result.row(key).errors.rel.value),
                *cells,
                "" if spectral is None else format_percent(spectral),
            ]
        )
    return Table(
        ["light", "error", *CAUSES, "spectral"],
        rows,
        "What each cause changes in the image, in % of the truth's RMS, and in brackets its part of the "
        "squared error in %; the parts add up to 100, a negative one offsets others. `filter`: one mean "
        "normal a pixel; `truncation`: light and cosine beyond the order; `visibility`: cast shadows and "
        "hidden sky; `interreflection`: light from one part of the surface on another; `gloss`: what the "
        "surface mirrors; `noise`: of the model's own capture. `spectral` stands apart: the truth is RGB, "
        "and this is what rendering with spectra would change in it.",
    )


def errors_table(study: Study) -> Table:
    """The other measures of all models, over all lights."""
    results = study.scene.results
    flips = results[0].rows[0].errors.flip is not None
    rows = []
    for row in results[0].rows:
        errors = [result.row(row.key).errors for result in results]
        flip = f"{np.mean([e.flip for e in errors]):.3f}" if flips else "\u2013"
        rows.append(
            [
                row.name,
                f"{np.mean([e.mae_8bit for e in errors]):.2f}",
                f"{np.mean([e.delta_e for e in errors]):.2f}",
                format_percent(max(e.worst for e in errors)),
                flip,
            ]
        )
    floor = [result.floor for result in results]
    missing = "" if flips else f" FLIP is not installed: `{INSTALL}`."
    return Table(
        ["model", "MAE, 8-bit sRGB", "Delta E 2000", "worst 8 x 8 block", "FLIP"],
        rows,
        "Means over the lights; the worst block is that of any light, against the RMS of the whole image. "
        "The references' noise is in these measures (not in the worst block): two references differ from "
        f"each other by {np.mean([e.mae_8bit for e in floor]):.2f} in 8-bit units and "
        f"{np.mean([e.delta_e for e in floor]):.2f} in Delta E, their mean from the truth by about half of "
        f"that.{missing}",
    )


def times_table(study: Study) -> Table:
    """Time of an image by where it goes."""
    rows = []
    for model in study.models:
        times, cold = study.times[model.key], study.cold.get(model.key)
        warm = times.warm
        parts = [warm.total, times.frozen, warm.tracing, warm.codegen, warm.execution]
        rows.append(
            [
                model.name,
                format_duration(cold.total) if cold else "\u2013",
                *(format_duration(seconds) for seconds in parts),
                format_duration(study.capture_seconds(model)),
                f"{times.ns_per_pixel:.2f}",
                f"{100 * times.copy_share:.0f} %",
            ]
        )
    compiled = ""
    if "path" in study.cold:
        captures = [times.total for key, times in study.cold.items() if key.startswith("capture_")]
        compiled = (
            " In the same new process the path tracer's first image takes "
            f"{format_duration(study.cold['path'].total)} at 4 paths a pixel, first captures "
            f"{format_duration(min(captures))} to {format_duration(max(captures))}."
        )
    return Table(
        ["model", "cold", "warm", "frozen", "tracing", "code", "execution", "capture", "ns a pixel", "copy"],
        rows,
        "`cold`: the first call of a process with an empty kernel cache; equal kernels are compiled once, "
        "so that a model that shares its kernel with one above shows none. `warm`: any later image, and "
        "its parts: tracing in Python, looking the code up, executing. `frozen`: replayed by `dr.freeze` "
        "without tracing. `capture`: once a subject, warm. `ns a pixel`: execution of many images at once, "
        f"and `copy`: the bytes that it must move, over what a plain copy moves in that time.{compiled}",
    )


def renderers_table(study: Study) -> Table:
    """Every registered renderer: what it accounts for, its distance from the truth, or why there is none."""
    tried: dict[str, dict[str, None]] = {}
    for other in study.renderers:
        tried.setdefault(other.renderer, {})[other.light] = None
    fewest = min(tried.values(), key=len)
    lights = [light for light in fewest if all(light in each for each in tried.values())]
    rows = []
    for name in dict.fromkeys(other.renderer for other in study.renderers):
        mine = {other.light: other for other in study.renderers if other.renderer == name}
        one = next(iter(mine.values()))
        cells = [_error_cell(mine[light]) for light in lights]
        noise = (
            format_percent(max(r.noise for r in mine.values())) if any(r.noise for r in mine.values()) else ""
        )
        done = [other.seconds for other in mine.values() if other.errors]
        rows.append(
            [
                name,
                _accounts(one.capabilities),
                *cells,
                noise,
                format_duration(max(done)) if done else "\u2013",
                one.failure,
            ]
        )
    return Table(
        ["renderer", "accounts for", *lights, "noise", "time", "note"],
        rows,
        "Relative RMS errors against the same truth, a renderer's own noise left out: two that account for "
        "the same must agree, whoever wrote them. A path tracer that accounts for all should be at 0 but "
        f"for what noise leaves uncertain. `noise` is that of one image at {SAMPLES} paths a pixel. Times "
        "hold what a call needs beside its kernel, such as starting from the subject's mesh.",
    )


def other_renderers_table(study: Study) -> Table | None:
    """Renderers of other packages under every light, beside order 2; None without one."""
    names = list(dict.fromkeys(r.renderer for r in study.renderers if not is_built_in(r.renderer)))
    if not names:
        return None
    found = {(r.renderer, r.light): r for r in study.renderers}
    rows = [
        [
            result.light.name,
            format_percent(result.row("order2").errors.rel.value),
            *(_error_cell(found[name, result.light.name]) for name in names),
        ]
        for result in study.scene.results
    ]
    return Table(
        ["light", "order 2", *names],
        rows,
        "Relative RMS errors of renderers of other packages under every light, beside order-2 shading.",
    )


def format_percent(error: float) -> str:
    """A ratio in % with two digits."""
    value = float(f"{100 * error:.2g}")
    digits = 0 if value == 0 else min(max(0, 1 - math.floor(math.log10(abs(value)))), 2)
    return f"{value:.{digits}f} %"


def _unbroken(text: str) -> str:
    """The text on one line."""
    return text.replace(" ", "\u00a0")


def _interval(error: TimedError) -> str:
    low, high = error.interval or (error.error, error.error)
    return _unbroken(f"{format_percent(error.error)} ({100 * low:.1f} to {100 * high:.1f})")


def _crossover(study: Study, key: str) -> str:
    middle = float(np.median([result.crossover(key) for result in study.scene.results]))
    if not math.isfinite(middle):
        return "\u2013"
    return "< 1" if middle < 1 else f"{middle:.0f}" if middle < 1000 else f"{float(f'{middle:.2g}'):.0f}"


def _error_cell(other: RendererResult) -> str:
    return "\u2013" if other.errors is None else format_percent(other.errors.rel.value)


def _accounts(can: Capabilities | None) -> str:
    if can is None:
        return ""
    light = "all of the light" if can.order is None else f"order {can.order}"
    bounces = {0: "", -1: ", all bounces"}.get(can.bounces, f", {can.bounces} bounce")
    return f"{light}{', shadows' if can.visibility else ''}{bounces}{', gloss' if can.gloss else ''}"


_MAP_LIMIT = 0.3  # of error maps, relative to the RMS of the truth
_PAPER = "order2"  # the model of the paper that the project is about


def write_study_page(path: Path, study: Study, tolerance: float, record: Record) -> None:
    """Write the page, self-contained; versions and machine of a record go into its footer."""
    scene = study.scene.name.replace("_", " ")
    sections = [
        Section("In short", [_key_numbers(study), _explained(study)]),
        Section("The lights", [_lights(study)]),
        Section("Error against time", _pareto_blocks(study)),
        Section("Every model under every light", [models_table(study)]),
        Section("Why order 2 is wrong", [causes_table(study, _PAPER), *_pictures(study)]),
        Section("Other measures of the same errors", [errors_table(study)]),
        Section("Where the time goes", [times_table(study)]),
    ]
    if study.renderers:
        others = other_renderers_table(study)
        tables = [renderers_table(study), *([others] if others else [])]
        sections.append(Section("Every registered renderer", tables))
    machine = ", ".join(f"{key} {value}" for key, value in record.machine.items())
    versions = ", ".join(f"{name} {number}" for name, number in record.versions.items())
    footer = f"Measured by: {record.command}. {machine}. {versions}."
    write_page(
        path,
        f"How wrong is cheap shading? Scene: {scene}",
        summary_sentence(study, tolerance),
        sections,
        footer=footer,
    )


def scene_section(study: Study, tolerance: float) -> Section:
    """The same in short, as one section of another page."""
    blocks = [
        summary_sentence(study, tolerance),
        *_pareto_blocks(study),
        models_table(study),
        *_pictures(study),
    ]
    return Section(f"The scene {study.scene.name.replace('_', ' ')}", blocks)


def draw_pareto(study: Study) -> bytes:
    """The plot of error against time: soft and hard light apart."""
    panels = {
        f"{title} ({len(results)} light{'s' * (len(results) > 1)})": [
            *(pooled_error(study, model.key, results) for model in study.models),
            *path_candidates(results),
        ]
        for title, results in _by_hardness(study).items()
        if results
    }
    return pareto_plot(panels)


def error_maps(study: Study) -> dict[str, bytes]:
    """Signed maps of each model's error under each light, by ``LIGHT-RUNG``."""
    return {
        f"{result.light.name}-{model.key}": error_map(
            _difference(study, result, model.key),
            label="error / RMS of the truth",
            limit=_MAP_LIMIT,
            signed=True,
        )
        for result in study.scene.results
        for model in study.models
    }


def _lights(study: Study) -> Gallery:
    mask = study.scene.inputs.mask
    pictures = [
        (
            png_bytes(on_white(show_linear(result.truth.mean), mask)),
            f"{result.light.name}: {describe_light(result.light)}",
        )
        for result in study.scene.results
    ]
    return Gallery(
        pictures, "The truth under every light of this run, all exposed alike. White is not counted."
    )


def _key_numbers(study: Study) -> KeyNumbers:
    results = study.scene.results
    errors = {result.light.name: result.row(_PAPER).errors for result in results}
    worst = max(errors, key=lambda name: errors[name].rel.value)
    numbers = []
    if study.natural:
        mean = pooled_error(study, _PAPER, study.natural)
        numbers.append((format_percent(mean.error), "relative RMS error of order 2, mean over natural light"))
    numbers += [
        (format_percent(errors[worst].rel.value), f"the same under the hardest light here, {worst}"),
        (
            format_percent(max(e.worst for e in errors.values())),
            "in the worst 8 x 8 pixels of any of the images",
        ),
        (format_duration(study.times[_PAPER].warm.total), "time of an order-2 image"),
        (
            format_duration(float(np.median([r.paths[-1].seconds for r in results]))),
            f"of a path-traced one, {results[0].paths[-1].samples} paths a pixel",
        ),
    ]
    return KeyNumbers(numbers)


def _explained(study: Study) -> str:
    size, count = study.scene.subject.camera.size, int(study.scene.inputs.mask.sum())
    counted = (
        "whole pixels of face skin"
        if study.scene.inputs.maps.mask.sum() == count
        else "pixels that the surface fills"
    )
    return (
        "The truth is a path tracer that follows light through every bounce. Order l is the model that "
        "knows the light by (l + 1)^2 spherical harmonics for each colour and the surface by its normals; "
        "order 2 is what SfSNet and most of its field use. `visibility` adds cast shadows and `bounce` "
        "light from one surface to another, both traced once for each subject; `gloss` adds what skin "
        "mirrors. An error is the root mean square of the difference from the truth, divided by the root "
        f"mean square of the truth, over {count} {counted} of {size} x {size}. The path tracer's own noise "
        "is taken out of it, by two independent references."
    )


def _pareto_blocks(study: Study) -> list[Block]:
    caption = (
        "Down and to the left is better. Soft light comes from a map of the surroundings; hard light has "
        "lamps or a sun in it, whose sharp shadows no smooth model holds. Errors are root mean squares over "
        "the lights, bars are 95 % intervals. The path tracer has no error but noise. Models with "
        "visibility, bounce or gloss need a capture once a subject, which is not in their time: "
        f"{_captures(study)}."
    )
    return [Figure(draw_pareto(study), caption, "Scatter plot of error against time with its Pareto front")]


def _captures(study: Study) -> str:
    seconds = {model.kind: study.capture_seconds(model) for model in study.models if model.kind != "analytic"}
    return ", ".join(f"{format_duration(value)} for {kind}" for kind, value in seconds.items())


def _pictures(study: Study) -> list[Block]:
    soft, hard = _by_hardness(study).values()
    natural = [result for result in soft if result.light.name.startswith("natural")]
    worst = sorted(hard, key=lambda result: result.row(_PAPER).errors.rel.value)
    return [_gallery(study, result) for result in (*(natural or soft)[:1], *worst[-1:])]


def _gallery(study: Study, result: LightResult) -> Gallery:
    mask, last = study.scene.inputs.mask, study.models[-1]
    shown = [("path traced", result.truth.mean)]
    shown += [
        (model.name, result.row(model.key).image) for model in study.models if model.key in (_PAPER, last.key)
    ]
    pictures = [(png_bytes(on_white(show_linear(image), mask)), label) for label, image in shown]
    pictures += [
        (png_bytes(signed_colours(_difference(study, result, key), _MAP_LIMIT)), f"{name} minus truth")
        for key, name in ((_PAPER, "order 2"), (last.key, last.name))
    ]
    return Gallery(
        pictures,
        f"Light: {result.light.name}. Red is too bright and blue too dark, full colour at "
        f"{100 * _MAP_LIMIT:g} % of the truth's root mean square. White is not counted.",
    )


def _difference(study: Study, result: LightResult, key: str) -> npt.NDArray[np.float64]:
    """(H, W) signed error over the RMS of the truth, mean over colours; NaN where nothing is counted."""
    mask, truth = study.scene.inputs.mask, result.truth.mean
    power = float((truth**2 * mask[..., None]).sum() / (3 * mask.sum()))
    difference = (result.row(key).image - truth).mean(axis=-1) / np.sqrt(power)
    return np.asarray(np.where(mask > 0, difference, np.nan))


def _by_hardness(study: Study) -> dict[str, tuple[LightResult, ...]]:
    results = study.scene.results
    return {
        "Soft light": tuple(result for result in results if not result.hard),
        "Hard light": tuple(result for result in results if result.hard),
    }
