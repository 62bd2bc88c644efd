"""The page of a validation: what is wrong, by how much, why, and what mending it costs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from sfsnet_dr.apply.display import on_white, png_bytes, show_linear
from sfsnet_dr.report.figures import error_map, signed_colours
from sfsnet_dr.report.html import Block, Figure, Gallery, KeyNumbers, Section, write_page
from sfsnet_dr.report.pareto import pareto_plot
from sfsnet_dr.report.record import Record
from sfsnet_dr.scene.light_sets import describe
from sfsnet_dr.study.ladder import LightResult
from sfsnet_dr.study.validate_tables import (
    causes_table,
    errors_table,
    models_table,
    percent,
    renderers_table,
    times_table,
)
from sfsnet_dr.study.verdict import Study, duration, paths, pooled, sentence

_MAP_LIMIT = 0.3  # of error maps, relative to the RMS of the truth
_PAPER = "order2"  # the model of the paper that the project is about


def write_study_page(path: Path, study: Study, tolerance: float, record: Record) -> None:
    """Write the page, self-contained; versions and machine of a record go into its footer."""
    scene = study.ladder.name.replace("_", " ")
    sections = [
        Section("In short", [_key_numbers(study), _explained(study)]),
        Section("The lights", [_lights(study)]),
        Section("Error against time", _pareto_blocks(study)),
        Section("Every model under every light", [models_table(study)]),
        Section("Why order 2 is wrong", [causes_table(study, _PAPER), *_pictures(study)]),
        Section("Other measures of the same errors", [errors_table(study)]),
        Section("Where the time goes", [times_table(study)]),
    ]
    if study.rivals:
        sections.append(Section("Every renderer that is registered", [renderers_table(study)]))
    machine = ", ".join(f"{key} {value}" for key, value in record.machine.items())
    versions = ", ".join(f"{name} {number}" for name, number in record.versions.items())
    footer = f"Measured by: {record.command}. {machine}. {versions}."
    write_page(
        path,
        f"How wrong is cheap shading? Scene: {scene}",
        sentence(study, tolerance),
        sections,
        footer=footer,
    )


def section(study: Study, tolerance: float) -> Section:
    """The same in short, as one section of another page."""
    blocks = [sentence(study, tolerance), *_pareto_blocks(study), models_table(study), *_pictures(study)]
    return Section(f"The scene {study.ladder.name.replace('_', ' ')}", blocks)


def pareto(study: Study) -> bytes:
    """The plot of error against time: soft and hard light apart."""
    panels = {
        f"{title} ({len(results)} light{'s' * (len(results) > 1)})": [
            *(pooled(study, rung.key, results) for rung in study.rungs),
            *paths(results),
        ]
        for title, results in _by_hardness(study).items()
        if results
    }
    return pareto_plot(panels)


def error_maps(study: Study) -> dict[str, bytes]:
    """Signed maps of each rung's error under each light, by ``LIGHT-RUNG``."""
    return {
        f"{result.light.name}-{rung.key}": error_map(
            _difference(study, result, rung.key),
            label="error / RMS of the truth",
            limit=_MAP_LIMIT,
            signed=True,
        )
        for result in study.ladder.results
        for rung in study.rungs
    }


def _lights(study: Study) -> Gallery:
    mask = study.ladder.known.mask
    pictures = [
        (
            png_bytes(on_white(show_linear(result.truth.mean), mask)),
            f"{result.light.name}: {describe(result.light)}",
        )
        for result in study.ladder.results
    ]
    return Gallery(
        pictures, "The truth under every light of this run, all exposed alike. White is not counted."
    )


def _key_numbers(study: Study) -> KeyNumbers:
    results = study.ladder.results
    errors = {result.light.name: result.row(_PAPER).errors for result in results}
    worst = max(errors, key=lambda name: errors[name].rel.value)
    numbers = []
    if study.natural:
        mean = pooled(study, _PAPER, study.natural)
        numbers.append((percent(mean.error), "relative RMS error of order 2, mean over natural light"))
    numbers += [
        (percent(errors[worst].rel.value), f"the same under the hardest light here, {worst}"),
        (percent(max(e.worst for e in errors.values())), "in the worst 8 x 8 pixels of any of the images"),
        (duration(study.times[_PAPER].warm.total), "time of an order-2 image"),
        (
            duration(float(np.median([r.paths[-1].seconds for r in results]))),
            f"of a path-traced one, {results[0].paths[-1].samples} paths a pixel",
        ),
    ]
    return KeyNumbers(numbers)


def _explained(study: Study) -> str:
    size, count = study.ladder.subject.camera.size, int(study.ladder.known.mask.sum())
    counted = (
        "whole pixels of face skin"
        if study.ladder.known.maps.mask.sum() == count
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
    return [Figure(pareto(study), caption, "Scatter plot of error against time with its Pareto front")]


def _captures(study: Study) -> str:
    seconds = {rung.kind: study.capture_seconds(rung) for rung in study.rungs if rung.kind != "analytic"}
    return ", ".join(f"{duration(value)} for {kind}" for kind, value in seconds.items())


def _pictures(study: Study) -> list[Block]:
    soft, hard = _by_hardness(study).values()
    natural = [result for result in soft if result.light.name.startswith("natural")]
    worst = sorted(hard, key=lambda result: result.row(_PAPER).errors.rel.value)
    return [_gallery(study, result) for result in (*(natural or soft)[:1], *worst[-1:])]


def _gallery(study: Study, result: LightResult) -> Gallery:
    mask, last = study.ladder.known.mask, study.rungs[-1]
    shown = [("path traced", result.truth.mean)]
    shown += [
        (rung.name, result.row(rung.key).image) for rung in study.rungs if rung.key in (_PAPER, last.key)
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
    mask, truth = study.ladder.known.mask, result.truth.mean
    power = float((truth**2 * mask[..., None]).sum() / (3 * mask.sum()))
    difference = (result.row(key).image - truth).mean(axis=-1) / np.sqrt(power)
    return np.asarray(np.where(mask > 0, difference, np.nan))


def _by_hardness(study: Study) -> dict[str, tuple[LightResult, ...]]:
    results = study.ladder.results
    return {
        "Soft light": tuple(result for result in results if not result.hard),
        "Hard light": tuple(result for result in results if result.hard),
    }
