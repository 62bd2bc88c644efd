"""The tables of a validation's page."""

from __future__ import annotations

import math

import numpy as np

from sfsnet_dr.metrics.flip import INSTALL
from sfsnet_dr.render.renderer import Capabilities
from sfsnet_dr.report.html import Table
from sfsnet_dr.report.pareto import TimedError
from sfsnet_dr.study.causes import CAUSES
from sfsnet_dr.study.rivals import SAMPLES, Rival, spectral_size
from sfsnet_dr.study.verdict import Study, duration, pooled

_PATH_ROWS = "path_"


def models_table(study: Study) -> Table:
    """Relative errors: models by lights, with time and crossover."""
    results = study.ladder.results
    rows = []
    for row in results[0].rows:
        cells = [percent(result.row(row.key).errors.rel.value) for result in results]
        timed = row.key in study.times
        natural = [_interval(pooled(study, row.key, study.natural)) if timed else ""] if study.natural else []
        time = duration(study.times[row.key].warm.total) if timed else "\u2013"
        rows.append([_unbroken(row.name), time, _crossover(study, row.key), *natural, *cells])
    for k, path in enumerate(results[0].paths):
        cells = [percent(result.paths[k].noise) for result in results]
        seconds = float(np.median([result.paths[k].seconds for result in results]))
        natural = [""] if study.natural else []
        rows.append([_unbroken(f"{path.samples} paths (noise)"), duration(seconds), "", *natural, *cells])
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
    for result in study.ladder.results:
        parts = result.row(key).parts
        cells = [f"{percent(parts[cause].size)} ({100 * parts[cause].share:.0f})" for cause in CAUSES]
        spectral = spectral_size(study.rivals, result.light.name)
        rows.append(
            [
                result.light.name,
                percent(result.row(key).errors.rel.value),
                *cells,
                "" if spectral is None else percent(spectral),
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
    results = study.ladder.results
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
                percent(max(e.worst for e in errors)),
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
    for rung in study.rungs:
        times, cold = study.times[rung.key], study.cold.get(rung.key)
        warm = times.warm
        parts = [warm.total, times.frozen, warm.tracing, warm.codegen, warm.execution]
        rows.append(
            [
                rung.name,
                duration(cold.total) if cold else "\u2013",
                *(duration(seconds) for seconds in parts),
                duration(study.capture_seconds(rung)),
                f"{times.ns_per_pixel:.2f}",
                f"{100 * times.copy_share:.0f} %",
            ]
        )
    compiled = ""
    if "path" in study.cold:
        captures = [times.total for key, times in study.cold.items() if key.startswith("capture_")]
        compiled = (
            " In the same new process the path tracer's first image takes "
            f"{duration(study.cold['path'].total)} at 4 paths a pixel, first captures "
            f"{duration(min(captures))} to {duration(max(captures))}."
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
    lights = list(dict.fromkeys(rival.light for rival in study.rivals))
    rows = []
    for name in dict.fromkeys(rival.renderer for rival in study.rivals):
        mine = {rival.light: rival for rival in study.rivals if rival.renderer == name}
        one = next(iter(mine.values()))
        cells = [_rival_cell(mine[light]) for light in lights]
        noise = percent(max(r.noise for r in mine.values())) if any(r.noise for r in mine.values()) else ""
        done = [rival.seconds for rival in mine.values() if rival.errors]
        rows.append(
            [
                name,
                _accounts(one.capabilities),
                *cells,
                noise,
                duration(max(done)) if done else "\u2013",
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


def percent(error: float) -> str:
    """A ratio in % with two digits."""
    value = float(f"{100 * error:.2g}")
    digits = 0 if value == 0 else min(max(0, 1 - math.floor(math.log10(abs(value)))), 2)
    return f"{value:.{digits}f} %"


def _unbroken(text: str) -> str:
    """The text on one line."""
    return text.replace(" ", "\u00a0")


def _interval(error: TimedError) -> str:
    low, high = error.interval or (error.error, error.error)
    return _unbroken(f"{percent(error.error)} ({100 * low:.1f} to {100 * high:.1f})")


def _crossover(study: Study, key: str) -> str:
    middle = float(np.median([result.crossover(key) for result in study.ladder.results]))
    if not math.isfinite(middle):
        return "\u2013"
    return "< 1" if middle < 1 else f"{middle:.0f}" if middle < 1000 else f"{float(f'{middle:.2g}'):.0f}"


def _rival_cell(rival: Rival) -> str:
    return "\u2013" if rival.errors is None else percent(rival.errors.rel.value)


def _accounts(can: Capabilities | None) -> str:
    if can is None:
        return ""
    light = "all of the light" if can.order is None else f"order {can.order}"
    bounces = {0: "", -1: ", all bounces"}.get(can.bounces, f", {can.bounces} bounce")
    return f"{light}{', shadows' if can.visibility else ''}{bounces}{', gloss' if can.gloss else ''}"
