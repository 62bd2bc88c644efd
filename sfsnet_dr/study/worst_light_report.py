"""``sfsnet-dr worst-light``: records, a table and a page of ``study.worst_light``."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from sfsnet_dr.base.atomic import output_dir, write_text
from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.report.console import bar
from sfsnet_dr.report.record import Record, measured, write_records
from sfsnet_dr.scene.validation_scenes import load_subject_by_name
from sfsnet_dr.study.light_answers import Effort
from sfsnet_dr.study.light_prior import mean, p95
from sfsnet_dr.study.worst_light import LIGHTS, WorstLight, steps, study
from sfsnet_dr.study.worst_light_page import COLOURS, write_worst_light_page


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
        BadInput: for an unknown scene or numbers out of range.
    """
    _check(effort, lights)
    subject, folder = load_subject_by_name(scene, seed), output_dir(out)
    with bar(f"worst light of {subject.spec.name}", steps(effort)) as step:
        found = study(subject, effort, order=order, lights=lights, seed=seed, step=step)
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
        records.append(measured(name, value, unit, command=command, interval=interval, seed=seed))

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
        add(f"{prefix}prior.mean", mean(result.prior), interval=found.prior_interval(order, mean))
        add(f"{prefix}prior.p95", p95(result.prior), interval=found.prior_interval(order, p95))
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
            raise BadInput(f"{name}: {value} found, {low} to {high} allowed")


def _prefix(order: int) -> str:
    return "" if order == 2 else f"order{order}."
