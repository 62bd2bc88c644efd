"""``sfsnet-dr validate``: the ladder of models on one scene, as records, a table, a plot and a page."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from sfsnet_dr.apply.display import on_white, png_bytes, show_linear
from sfsnet_dr.base.atomic import output_dir, write_text
from sfsnet_dr.base.checks import WorkFailed
from sfsnet_dr.report.figures import TimedError, error_map, error_vs_time
from sfsnet_dr.report.html import Block, Figure, Gallery, Section, Table, write_page
from sfsnet_dr.report.record import Record, measured, write_records
from sfsnet_dr.scene.spec import load_scene
from sfsnet_dr.study.ladder import ORDERS, Ladder, LightResult, Rung, climb

_MAP_LIMIT = 0.3  # of the error map, relative to the RMS of the reference


def validate(
    scene: Path | str,
    out: Path | str,
    tolerance: float | None = None,
    *,
    seed: int = 0,
    command: str = "sfsnet-dr validate",
) -> list[Record]:
    """Measure a scene and write ``records.json``, ``ladder.csv`` and ``index.html``.

    Args:
        scene: a TOML file of ``scenes/``.
        out: folder for the results.
        tolerance: relative RMS error allowed to order 2; None allows any.
        seed: of the head and the noise.
        command: what the records say measured them.

    Raises:
        BadInput: for a bad scene file or folder.
        WorkFailed: if order 2 is worse than the tolerance; the results are written all the same.
    """
    spec, folder = load_scene(scene), output_dir(out)
    ladder = climb(spec, seed)
    found = ladder_records(ladder, command, seed)
    write_records(folder / "records.json", found)
    write_text(folder / "ladder.csv", to_csv(ladder))
    write_page(
        folder / "index.html", f"Validation: {spec.name}", cheapest(ladder, tolerance), [section(ladder)]
    )
    error = pooled(ladder, "order 2").error
    if tolerance is not None and error > tolerance:
        raise WorkFailed(
            f"{spec.name}: order 2 has a relative RMS error of {error:.4f}, {tolerance:g} is allowed; "
            f"see {folder}"
        )
    return found


def pooled(ladder: Ladder, name: str) -> TimedError:
    """A rung over the natural lights: RMS of the relative errors, median time."""
    rungs = [result.rung(name) for result in _natural(ladder)]

    def together(values: list[float]) -> float:
        return float(np.sqrt(np.mean(np.square(values))))

    return TimedError(
        name=name,
        group=rungs[0].group,
        seconds=float(np.median([rung.seconds for rung in rungs])),
        error=together([rung.error.value for rung in rungs]),
        interval=(together([r.error.low for r in rungs]), together([r.error.high for r in rungs])),
    )


def ladder_records(ladder: Ladder, command: str, seed: int) -> list[Record]:
    """Error and time of every model: over the natural lights, and for each light."""
    records = []
    for name in [f"order {order}" for order in ORDERS] + ["order 2 + visibility"]:
        key = f"validate.{_key(name)}.{ladder.spec.name}"
        over_all = pooled(ladder, name)
        records.append(
            measured(
                f"{key}.rel_rmse", over_all.error, "1", command=command, interval=over_all.interval, seed=seed
            )
        )
        records.append(measured(f"{key}.seconds", over_all.seconds, "s", command=command, seed=seed))
        for result in ladder.results:
            error = result.rung(name).error
            records.append(
                measured(
                    f"{key}.{result.light.name}.rel_rmse",
                    error.value,
                    "1",
                    command=command,
                    interval=(error.low, error.high),
                    seed=seed,
                )
            )
    return records


def cheapest(ladder: Ladder, tolerance: float | None) -> str:
    """One sentence: the cheapest model within the tolerance (5 % if None), a capture counted as its cost."""
    allowed = 0.05 if tolerance is None else tolerance
    names = [f"order {order}" for order in ORDERS] + ["order 2 + visibility"]
    within = [rung for rung in (pooled(ladder, name) for name in names) if rung.error <= allowed]
    if not within:
        return f"No shading model meets {100 * allowed:g} % on {ladder.spec.name}: path tracing is needed."
    cost = {"analytic": 0.0, "visibility": ladder.capture_seconds}
    best = min(within, key=lambda rung: rung.seconds + cost[rung.group])
    return (
        f"The cheapest model within {100 * allowed:g} % on {ladder.spec.name} is {best.name}: "
        f"{100 * best.error:.2g} % relative RMS error in {1e3 * best.seconds:.2g} ms an image."
    )


def section(ladder: Ladder) -> Section:
    """Table, plot and pictures of a scene for a page."""
    name = ladder.spec.name
    natural = _natural(ladder)
    rungs = [pooled(ladder, rung.name) for rung in natural[0].rungs]
    blocks: list[Block] = [
        cheapest(ladder, None),
        _table(ladder),
        Figure(
            error_vs_time([rung for rung in rungs if rung.error > 0]),
            f"Error against time of one image of the {name}, {ladder.spec.camera.size} pixels square, "
            "over the natural lights. Down and to the left is better. The path tracer's error is its noise.",
        ),
    ]
    blocks += [_pictures(ladder, result) for result in (natural[0], ladder.results[-1])]
    worst = ladder.results[-1]
    blocks.append(
        Figure(_error_picture(ladder, worst), f"Order 2 minus reference, {worst.light.name} light.")
    )
    return Section(f"The {name}", blocks)


def to_csv(ladder: Ladder) -> str:
    """One line for each light and model."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["scene", "light", "model", "rel_rmse", "low", "high", "seconds", "crossover_spp"])
    for result in ladder.results:
        for rung in result.rungs:
            error = rung.error
            writer.writerow(
                [
                    ladder.spec.name,
                    result.light.name,
                    rung.name,
                    *(f"{x:.6g}" for x in (error.value, error.low, error.high, rung.seconds)),
                    f"{result.crossover(rung.name):.4g}",
                ]
            )
    return text.getvalue()


def _table(ladder: Ladder) -> Table:
    rows = []
    for index, rung in enumerate(ladder.results[0].rungs):
        cells = [_percent(result.rungs[index]) for result in ladder.results]
        rows.append(
            [rung.name, *cells, _milliseconds(pooled(ladder, rung.name).seconds), _crossover(ladder, rung)]
        )
    headers = ["model", *(result.light.name for result in ladder.results), "time (ms)", "N*"]
    return Table(
        headers,
        rows,
        "Relative RMS error in % against the path tracer, with 95 % intervals and the reference's noise "
        "taken out, and the warm time of one image. N* is the number of samples a pixel from which the path "
        f"tracer is more accurate. Visibility needs a capture of {ladder.capture_seconds:.1f} s once a face, "
        f"and on a convex shape shows the noise of its {ladder.spec.sampling.transport} directions.",
    )


def _percent(rung: Rung) -> str:
    error = rung.error
    if rung.group == "path tracer":
        return f"{100 * error.value:.1f}"
    return f"{100 * error.value:.1f} ({100 * error.low:.1f}–{100 * error.high:.1f})"  # noqa: RUF001


def _crossover(ladder: Ladder, rung: Rung) -> str:
    if rung.group == "path tracer":
        return ""
    return f"{np.median([result.crossover(rung.name) for result in _natural(ladder)]):.0f}"


def _milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:.2f}" if seconds < 0.1 else f"{1e3 * seconds:.0f}"


def _pictures(ladder: Ladder, result: LightResult) -> Gallery:
    images = [("path traced", result.reference)]
    for name in ("order 2", "order 2 + visibility"):
        image = result.rung(name).image
        assert image is not None
        images.append((name, image))
    shown = [(png_bytes(on_white(show_linear(image), ladder.mask)), label) for label, image in images]
    return Gallery(shown, f"Light: {result.light.name}. White is not counted.")


def _error_picture(ladder: Ladder, result: LightResult) -> bytes:
    image = result.rung("order 2").image
    assert image is not None
    power = float((result.reference**2 * ladder.mask[..., None]).sum() / (3 * ladder.mask.sum()))
    difference = (image - result.reference).mean(axis=-1) / np.sqrt(power)
    return error_map(
        np.where(ladder.mask > 0, difference, np.nan),
        label="difference / RMS of the reference",
        limit=_MAP_LIMIT,
        signed=True,
    )


def _natural(ladder: Ladder) -> list[LightResult]:
    return [result for result in ladder.results if result.light.environment is not None]


def _key(name: str) -> str:
    return name.replace(" + ", "_").replace(" ", "")
