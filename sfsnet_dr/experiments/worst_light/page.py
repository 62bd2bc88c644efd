"""The page of ``study.worst_light``: numbers, maps over all directions, and the lights that were found.

``sfsnet-dr worst-light``: records, a table and a page of ``study.worst_light``.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import output_dir, write_text
from sfsnet_dr.core.visualize import on_white, show_linear
from sfsnet_dr.experiments.worst_light.responses import Effort, mean_error, percentile_95
from sfsnet_dr.experiments.worst_light.run import (
    DIMMEST,
    LIGHTS,
    Shown,
    WorstLight,
    study_steps,
    study_worst_light,
)
from sfsnet_dr.experiments.worst_light.search import WorstLightResult
from sfsnet_dr.report.console import progress_bar
from sfsnet_dr.report.html import Block, Figure, KeyNumbers, Note, Section, Table, write_page
from sfsnet_dr.report.light_plots import Panel, draw_hemispheres, draw_panels
from sfsnet_dr.report.plots import draw_histogram
from sfsnet_dr.report.record import Record, make_record, write_records
from sfsnet_dr.scene.lights.sampling import LARGEST_ANGLE
from sfsnet_dr.scene.subject import load_subject_by_name

Array = npt.NDArray[np.float64]

#: Names of the channels.
COLOURS = ("red", "green", "blue")


def write_worst_light_page(path: Path, found: WorstLight, versions: Mapping[str, str]) -> None:
    """Write the page, self-contained; ``versions`` of packages stand at its end."""
    footer = ", ".join(f"{name} {number}" for name, number in versions.items())
    write_page(path, f"Worst light: {_spoken(found.name)}", _lead(found), _sections(found), footer=footer)


def _lead(found: WorstLight) -> str:
    own, angle = found.own, np.degrees(np.arccos(found.direction[2]))
    mean, rare = _percent(mean_error(own.prior)), _percent(percentile_95(own.prior))
    return (
        f"On the {_spoken(found.name)}, order-{found.order} spherical-harmonic shading is off by {mean} of "
        f"the image under usual light ({rare} or more under one light in twenty), and by up to "
        f"{_percent(found.directional.error.value)} under a single directional light, which then comes from "
        f"{angle:.0f} degrees off the viewer's direction. All errors are root mean square over the pixels "
        "that count, against path tracing with shadows and interreflection, with the noise of the path "
        "tracing taken out."
    )


def _sections(found: WorstLight) -> list[Section]:
    return [_summary(found), _prior(found), _directions(found), _mixtures(found), _method(found)]


def _summary(found: WorstLight) -> Section:
    own = found.own
    numbers = KeyNumbers(
        [
            (_percent(mean_error(own.prior)), "mean over usual lights"),
            (_percent(percentile_95(own.prior)), "95th percentile over usual lights"),
            (_percent(found.directional.error.value), "worst directional light, up to 85° from the viewer"),
            (_percent(found.non_negative.error.value), "worst order-4 light without negative parts"),
            (_percent(found.signed.error.value), "worst order-4 light, negative parts allowed"),
        ]
    )
    rows = [
        [
            f"order {order}",
            _plain(mean_error(result.prior)),
            _plain(percentile_95(result.prior)),
            _plain(result.directional.pooled),
            _plain(float(np.nanmax(result.directional.of_own))),
            _plain(float(result.directional.of_mean.max())),
            _plain(result.non_negative.error),
            _plain(result.signed.error),
        ]
        for order, result in found.by_order.items()
    ]
    headers = ["model", "mean", "95th", "pooled", "worst", "of mean", "order 4", "signed"]
    caption = (
        "Relative RMS error in %. Under usual lights: mean and 95th percentile. Under one directional light: "
        "root mean square over all directions, the worst of up to 85 degrees from the viewer, and the worst "
        "of all relative to the mean image. Under lights of order 4: the worst without negative parts, and "
        "the worst with. A light that order 2 does not see at all makes 100 %; what exceeds that shows light "
        "where there is none."
    )
    return Section("In short", [numbers, Table(headers, rows, caption)])


def _prior(found: WorstLight) -> Section:
    errors, kinds = found.own.prior, np.array(found.kinds)
    rows = [_prior_row("all", errors)] + [
        _prior_row(kind.replace("_", " "), errors[kinds == kind]) for kind in sorted(set(found.kinds))
    ]
    table = Table(
        ["light", "lights", "mean", "median", "95th percentile", "largest"],
        rows,
        "Relative RMS error in %. The kinds are those that data sets are rendered with.",
    )
    edges = np.linspace(0.0, 100 * float(np.ceil(errors.max() * 20) / 20), 26)
    plot = draw_histogram(
        [100 * value for value in errors],
        label=f"relative RMS error of order {found.order} (%)",
        bins=[float(edge) for edge in edges],
        counted="lights",
    )
    caption = f"{len(errors)} lights drawn from the prior, each with its error."
    return Section("Under usual lights", [table, Figure(plot, caption)])


def _directions(found: WorstLight) -> Section:
    result = found.own.directional
    own, mean = 100 * result.of_own, 100 * result.of_mean
    maps = [
        Figure(
            draw_hemispheres(
                own, found.directions, label="error (%)", limit=_round(own), mark=found.direction
            ),
            "Error under one directional light, relative to the image under that light, by where the "
            "light comes from. The middle of the left disk is the viewer, its edge is light from exactly "
            "the side. White: more than 85 degrees from the viewer, where less and less of what is seen "
            "is lit, so that this ratio grows without limit. The circle marks the worst.",
        ),
        Figure(
            draw_hemispheres(mean, found.directions, label="error (%)", limit=_round(mean)),
            "The same errors relative to the mean image (root mean square over all directions), which is "
            "defined for light from behind too.",
        ),
    ]
    x, y, z = found.direction
    caption = f"The worst directional light, from ({x:.2f}, {y:.2f}, {z:.2f}): right, up, toward the viewer."
    blocks = [*maps, _pictures(found, found.directional, caption)]
    return Section("Under one directional light", [*blocks, _confirmed(found.directional)])


def _mixtures(found: WorstLight) -> Section:
    texts = (
        "The worst of all lights of order 4. Where blue it is negative, as no lamp can be. In the middle of "
        "the first picture is light from the viewer, at its left and right edge light from behind.",
        "The worst light of order 4 that is negative nowhere.",
    )
    less = Note(
        "Real light is not negative: that restriction alone takes the worst error from "
        f"{_percent(found.signed.error.value)} to {_percent(found.non_negative.error.value)}."
    )
    blocks: list[Block] = [less]
    lights = ((found.own.signed, found.signed), (found.own.non_negative, found.non_negative))
    for text, (light, shown) in zip(texts, lights, strict=True):
        more = (
            f" It stands in the {COLOURS[light.colour]} channel alone, for no coloured light is worse. Its "
            f"image is {_percent(light.brightness)} as bright as light of its energy can be."
        )
        blocks += [_pictures(found, shown, text + more), _coefficients(light), _confirmed(shown)]
    return Section("Under any light of order 4", blocks)


def _method(found: WorstLight) -> Section:
    return Section(
        "How it was measured",
        [
            f"Transport of order 4 and answers to {len(found.directions)} directional lights were "
            "path-traced twice with independent random numbers. Sums over pixels multiply one with the "
            "other, never one with itself, so that noise drops out (that of a single answer is "
            f"{_percent(found.noise)} of the brightest).",
            "The worst signed light is the greatest eigenvalue of error against image; an image dimmer "
            f"than {_percent(DIMMEST)} of the brightest that a light of its energy gives counts as that "
            "bright, or the worst light would be one that lights nothing in view. The worst light "
            "without negative parts is the best of a local search, so that a still worse one may exist. "
            f"Usual lights are mixtures of the directional ones, hard ones at most {LARGEST_ANGLE:.0f} "
            "degrees from the viewer.",
            "Each light shown was then rendered by Mitsuba's own path tracer, which has no code in "
            "common with the search.",
        ],
    )


def _pictures(found: WorstLight, shown: Shown, caption: str) -> Figure:
    error = np.where(found.mask, (shown.model - shown.image).mean(axis=-1), np.nan)
    power = float(np.sqrt((shown.image[found.mask] ** 2).mean()))
    signed = shown.sky is not None
    images = (("path traced", shown.image), (f"order {found.order}", shown.model))
    row = []
    if shown.sky is not None:
        row.append(Panel("the light", shown.sky / np.abs(shown.sky).max(), 1.0))
    top = float(np.percentile(np.abs(shown.image[found.mask]), 99))
    for title, image in images:
        if signed:
            row.append(Panel(title, np.where(found.mask, image[..., 0] / top, np.nan), 1.0))
        else:
            row.append(Panel(title, on_white(show_linear(image / top), found.mask.astype(np.float64))))
    limit = _round(np.abs(100 * error / power))
    row.append(Panel("difference", 100 * error / power, limit, "% of the image's RMS"))
    return Figure(draw_panels(row), caption)


def _coefficients(worst: WorstLightResult) -> Table:
    bands = np.repeat(np.arange(5), 2 * np.arange(5) + 1)
    energy = [float((worst.light[bands == band] ** 2).sum()) for band in range(5)]
    rounded = np.round(worst.light, 3) + 0.0  # no minus before a zero
    rows = [
        [
            f"{band}",
            f"{100 * energy[band]:.1f}",
            ", ".join(f"{x:.3f}" for x in rounded[bands == band]),
        ]
        for band in range(5)
    ]
    return Table(["band", "energy (%)", "radiance coefficients"], rows, "The light, of length 1.")


def _confirmed(shown: Shown) -> str:
    return (
        f"Relative RMS error {_interval(shown.error)} by the captures, {_interval(shown.traced)} by the path "
        "tracer (95 % intervals over blocks of pixels)."
    )


def _interval(error: object) -> str:
    value, low, high = (100 * getattr(error, name) for name in ("value", "low", "high"))
    return f"{value:.1f} % ({low:.1f} to {high:.1f})"


def _prior_row(name: str, errors: Array) -> list[str]:
    values = (errors.mean(), np.median(errors), np.quantile(errors, 0.95), errors.max())
    return [name, f"{len(errors)}", *(_plain(float(value)) for value in values)]


def _spoken(name: str) -> str:
    return name.replace("_", " ")


def _round(values: Array) -> float:
    """The 99th percentile, rounded up to a number for the end of a scale."""
    top = float(np.nanpercentile(values, 99))
    step = 10.0 ** np.floor(np.log10(max(top, 1e-6))) / 2
    return float(np.ceil(top / step) * step)


def _percent(ratio: float) -> str:
    return f"{_plain(ratio)} %"


def _plain(ratio: float) -> str:
    value = 100 * ratio
    return f"{value:.0f}" if value >= 99.5 else f"{value:.1f}" if value >= 0.1 else f"{value:.2f}"


def worst_light(
    scene: str,
    out: Path | str,
    effort: Effort,
    *,
    order: int = 2,
    lights: int = LIGHTS,
    seed: int = 0,
    command: str = "sfsnet-dr worst-light",
) -> list[Record]:
    """Study a scene and write ``records.json``, ``lights.json``, ``directions.csv`` and ``index.html``.

    Args:
        scene: name of a validation scene, or a file.
        out: folder for the results.
        effort: what is traced.
        order: of the model whose worst lights are shown.
        lights: drawn from the prior, at least 2.
        seed: of the head, the lights and the noise.
        command: what the records say measured them.

    Raises:
        InputError: for an unknown scene or numbers out of range.
    """
    _check(effort, lights)
    subject, folder = load_subject_by_name(scene, seed), output_dir(out)
    with progress_bar(f"worst light of {subject.spec.name}", study_steps(effort)) as step:
        found = study_worst_light(subject, effort, order=order, lights=lights, seed=seed, step=step)
    records = worst_light_records(found, command, seed)
    write_records(folder / "records.json", records)
    write_text(folder / "lights.json", json.dumps(found_lights(found), indent=2) + "\n")
    write_text(folder / "directions.csv", to_csv(found))
    write_worst_light_page(folder / "index.html", found, records[0].versions)
    return records


def worst_light_records(found: WorstLight, command: str, seed: int) -> list[Record]:
    """Everything measured; names carry the order where it is not 2."""
    records: list[Record] = []

    def add(what: str, value: float, unit: str = "1", interval: tuple[float, float] | None = None) -> None:
        name = f"worst_light.{found.name}.{what}"
        records.append(make_record(name, value, unit, command=command, interval=interval, seed=seed))

    prefix = _prefix(found.order)
    shown = {
        "signed": found.signed,
        "non_negative": found.non_negative,
        "directional": found.directional,
    }
    for name, one in shown.items():
        add(prefix + name, one.error.value, interval=(one.error.low, one.error.high))
        add(f"{prefix}{name}.path_traced", one.traced.value, interval=(one.traced.low, one.traced.high))
    angle = float(np.degrees(np.arccos(found.direction[2])))
    add(f"{prefix}directional.angle", angle, "degree")
    for order, result in found.by_order.items():
        prefix = _prefix(order)
        if order != found.order:
            add(f"{prefix}signed", result.signed.error)
            add(f"{prefix}non_negative", result.non_negative.error)
            add(f"{prefix}directional", float(np.nanmax(result.directional.of_own)))
        add(f"{prefix}directional.over_mean", float(result.directional.of_mean.max()))
        add(f"{prefix}directional.pooled", result.directional.pooled)
        add(f"{prefix}prior.mean", mean_error(result.prior), interval=found.prior_interval(order, mean_error))
        add(
            f"{prefix}prior.p95",
            percentile_95(result.prior),
            interval=found.prior_interval(order, percentile_95),
        )
    return records


def found_lights(found: WorstLight) -> dict[str, dict[str, Any]]:
    """The worst lights: channel and 25 radiance coefficients, or a unit vector toward the light."""
    mixed = {"signed": found.own.signed, "non_negative": found.own.non_negative}
    lights: dict[str, dict[str, Any]] = {
        name: {"channel": COLOURS[worst.colour], "radiance": [float(value) for value in worst.light]}
        for name, worst in mixed.items()
    }
    return lights | {"directional": {"direction": [float(value) for value in found.direction]}}


def to_csv(found: WorstLight) -> str:
    """One line a direction: the vector toward the light, and both errors of the order that is shown."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["x", "y", "z", "error_of_own_image", "error_of_mean_image"])
    result = found.own.directional
    for direction, own, of_mean in zip(found.directions, result.of_own, result.of_mean, strict=True):
        cells = [*(f"{value:.6f}" for value in direction), "" if np.isnan(own) else f"{own:.6g}"]
        writer.writerow([*cells, f"{of_mean:.6g}"])
    return text.getvalue()


def _check(effort: Effort, lights: int) -> None:
    limits = {
        "size": (effort.size or 64, 16, 1024),
        "samples": (effort.samples, 2, 4096),
        "level": (effort.level, 1, 4),
        "lights": (lights, 20, 100_000),
    }
    for name, (value, low, high) in limits.items():
        if not low <= value <= high:
            raise InputError(f"{name}: {value} found, {low} to {high} allowed")


def _prefix(order: int) -> str:
    return "" if order == 2 else f"order{order}."
