"""A study's numbers as records and as a table of comma-separated values."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

from sfsnet_dr.experiments.validation.error_sources import CAUSES
from sfsnet_dr.experiments.validation.measure import Errors, LightResult, Row
from sfsnet_dr.experiments.validation.models import ShadingModel
from sfsnet_dr.experiments.validation.renderers import RendererResult, spectral_size
from sfsnet_dr.experiments.validation.summary import Study, cheapest_model, pooled_error
from sfsnet_dr.report.record import Record, dotted_word, make_record

_Add = Callable[..., Record]

#: The light whose errors are stored for every model and renderer: one lamp, where cast shadows are largest.
STORED_LIGHT: Final = "directional60"

_COLUMNS: Final = (
    "scene", "light", "model", "rel_rmse", "low", "high", "worst_block", "mae_8bit", "delta_e_2000", "flip",
    "seconds", "crossover_spp",
)  # fmt: skip


def study_records(study: Study, tolerance: float, command: str, seed: int) -> list[Record]:
    """Every number: ``validate.<model>.<scene>.<light>.<what>``, and what holds for all lights without one.

    Without a light stand times, and ``rel_rmse`` over the natural lights (RMS of the three relative errors).
    A cause is given by its size, ``cause.<name>``, and its part of the squared error, ``share.<name>``.
    """
    return list(_records(study, tolerance, _maker(command, seed)))


def main_records(records: Iterable[Record]) -> list[Record]:
    """Choose the records of many scenes to store; ``errors.csv`` has the other errors, times and causes.

    Args:
        records: what ``study_records`` made of any number of scenes.

    Returns:
        The records without a light, relative errors under ``STORED_LIGHT``, the size of spectral effects
        (no column of ``errors.csv``), and everything of Cycles, which is not installed everywhere.
    """
    return [record for record in records if _is_stored(record.what.split("."))]


def _is_stored(what: Sequence[str]) -> bool:
    """Whether a name, ``validate.<model>.<scene>[.<light>].<what>`` split at its dots, is stored."""
    model, rest = what[1], what[3:]
    if len(rest) == 1 or rest[0] in ("time", "share"):
        return True
    return (
        rest == [STORED_LIGHT, "rel_rmse"] or rest[1:] == ["cause", "spectral"] or model.startswith("cycles-")
    )


def to_csv(study: Study) -> str:
    """One line for each light and model, renderers included."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    split = [f"{kind}_{cause}" for kind in ("size", "share") for cause in CAUSES]
    writer.writerow([*_COLUMNS, *split, "note"])
    scene, nothing = study.scene.name, [""] * (2 * len(CAUSES))
    for result in study.scene.results:
        for row in result.rows:
            seconds = study.times[row.key].warm.total if row.key in study.times else None
            parts = [row.parts[cause] for cause in CAUSES]
            numbers = [*_numbers(row.errors), seconds, result.crossover(row.key)]
            numbers += [*(part.size for part in parts), *(part.share for part in parts)]
            writer.writerow([scene, result.light.name, row.key, *map(_cell, numbers), ""])
        for path in result.paths:
            cells = [_cell(path.noise), *[""] * 6, _cell(path.seconds), "", *nothing]
            writer.writerow([scene, result.light.name, f"path_{path.samples}spp", *cells, "noise"])
    for other in study.renderers:
        cells = [*map(_cell, [*_numbers(other.errors), other.seconds]), "", *nothing]
        writer.writerow([scene, other.light, other.renderer, *cells, other.failure])
    return text.getvalue()


def _records(study: Study, tolerance: float, add: _Add) -> Iterator[Record]:
    scene = dotted_word(study.scene.name)
    best = cheapest_model(study, tolerance)
    if best is not None:
        yield add(f"validate.cheapest.{scene}.rel_rmse", best.error, "1")
        yield add(f"validate.cheapest.{scene}.seconds", best.seconds, "s")
    for model in study.models:
        yield from _of_model(study, model, f"validate.{model.key}.{scene}", add)
    for result in study.scene.results:
        for row in result.rows:
            yield from _of_row(result, row, f"validate.{row.key}.{scene}.{result.light.name}", add)
        for path in result.paths:
            name = f"validate.path_{path.samples}spp.{scene}.{result.light.name}"
            yield add(f"{name}.noise", path.noise, "1")
            yield add(f"{name}.seconds", path.seconds, "s")
        spectral = spectral_size(study.renderers, result.light.name)
        if spectral is not None:
            yield add(f"validate.path.{scene}.{result.light.name}.cause.spectral", spectral, "1")
    for other in study.renderers:
        yield from _of_renderer(
            other, f"validate.{dotted_renderer(other.renderer)}.{scene}.{other.light}", add
        )


def dotted_renderer(name: str) -> str:
    """A renderer's name as one word of a record's; ours are such words already."""
    return "-".join(dotted_word(part) for part in name.split("-"))


def _of_model(study: Study, model: ShadingModel, name: str, add: _Add) -> Iterator[Record]:
    if study.natural:
        error = pooled_error(study, model.key, study.natural)
        yield add(f"{name}.rel_rmse", error.error, "1", error.interval)
    times = study.times[model.key]
    yield add(f"{name}.seconds", times.warm.total, "s")
    yield add(f"{name}.time.frozen", times.frozen, "s")
    yield add(f"{name}.time.tracing", times.warm.tracing, "s")
    yield add(f"{name}.time.codegen", times.warm.codegen, "s")
    yield add(f"{name}.time.execution", times.warm.execution, "s")
    yield add(f"{name}.time.capture", study.capture_seconds(model), "s")
    yield add(f"{name}.time.ns_per_pixel", times.ns_per_pixel, "ns")
    yield add(f"{name}.share.copy_bandwidth", times.copy_share, "1")
    if model.key in study.cold:
        yield add(f"{name}.time.cold", study.cold[model.key].total, "s")
        yield add(f"{name}.time.compile", study.cold[model.key].backend, "s")


def _of_row(result: LightResult, row: Row, name: str, add: _Add) -> Iterator[Record]:
    errors = row.errors
    yield add(f"{name}.rel_rmse", errors.rel.value, "1", (errors.rel.low, errors.rel.high))
    yield add(f"{name}.worst_block", errors.worst, "1")
    yield add(f"{name}.mae_8bit", errors.mae_8bit, "8-bit sRGB")
    yield add(f"{name}.delta_e_2000", errors.delta_e, "Delta E")
    if errors.flip is not None:
        yield add(f"{name}.flip", errors.flip, "1")
    crossover = result.crossover(row.key)
    if math.isfinite(crossover):
        yield add(f"{name}.crossover", crossover, "paths per pixel")
    for cause in CAUSES:
        yield add(f"{name}.cause.{cause}", row.parts[cause].size, "1")
        yield add(f"{name}.share.{cause}", row.parts[cause].share, "1")


def _of_renderer(other: RendererResult, name: str, add: _Add) -> Iterator[Record]:
    if other.errors is None:
        return
    rel = other.errors.rel
    yield add(f"{name}.rel_rmse", rel.value, "1", (rel.low, rel.high))
    yield add(f"{name}.noise", other.noise, "1")
    yield add(f"{name}.seconds", other.seconds, "s")


def _maker(command: str, seed: int) -> _Add:
    """Makes records; versions and machine are looked up once, not for each of hundreds."""
    pattern = make_record("validate.pattern", 0.0, "1", command=command, seed=seed)

    def add(what: str, value: float, unit: str, interval: tuple[float, float] | None = None) -> Record:
        ends = None if interval is None else (min(interval[0], value), max(interval[1], value))
        return replace(pattern, what=what, value=float(value), unit=unit, interval=ends)

    return add


def _numbers(errors: Errors | None) -> list[float | None]:
    if errors is None:
        return [None] * 7
    rel = errors.rel
    return [rel.value, rel.low, rel.high, errors.worst, errors.mae_8bit, errors.delta_e, errors.flip]


def _cell(value: float | None) -> str:
    return "" if value is None else f"{value:.5g}"
