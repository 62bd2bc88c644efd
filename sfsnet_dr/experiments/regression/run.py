"""``sfsnet-dr regress``: the matrix, references, planted defects and clean runs, as records and a page."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from scipy.stats import binomtest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import output_dir
from sfsnet_dr.experiments.regression import fault_injection, page
from sfsnet_dr.experiments.regression.config import CONFIG, REFERENCES, RegressSpec, choose_pairs, read_spec
from sfsnet_dr.experiments.regression.diagnose import gather_evidence
from sfsnet_dr.experiments.regression.matrix import (
    Row,
    check_renderer,
    load_subjects,
    models_of_renderers,
    run_matrix,
)
from sfsnet_dr.experiments.regression.references import References, make_references
from sfsnet_dr.metrics.closed_form import has_closed_form
from sfsnet_dr.render.renderers.registry import is_built_in, renderers
from sfsnet_dr.report.console import progress_bar
from sfsnet_dr.report.html import Section, write_page
from sfsnet_dr.report.record import Record, dotted_word, make_record, write_records

#: Failing pairs that the page shows in pictures; all of them leave files.
_SHOWN: Final = 8
#: Level at which false alarms are counted: few enough to be rare, enough to be seen in a hundred pairs.
_COUNTED: Final = 0.05


@dataclass(frozen=True)
class Options:
    """What to do.

    Attributes:
        out: folder for the results.
        config: the matrix (TOML).
        references: folder of the stored references.
        scenes, lights, renderers: names with commas between, for a part of the matrix.
        seed: of the noise.
        update: make the references again before anything else, and only that.
        planted: plant defects instead of running the matrix.
        clean: number of clean runs instead of the matrix.
        across_versions: take references of another Mitsuba.
        command: what the records say measured them.
    """

    out: Path
    config: Path = CONFIG
    references: Path = REFERENCES
    scenes: str | None = None
    lights: str | None = None
    renderers: str | None = None
    seed: int = 0
    update: bool = False
    planted: bool = False
    clean: int = 0
    across_versions: bool = False
    command: str = "sfsnet-dr regress"


@dataclass(frozen=True)
class RegressionResult:
    """What came of it.

    Attributes:
        records: the numbers.
        ok: whether nothing is wrong.
        text: lines for people.
    """

    records: list[Record]
    ok: bool
    text: str


def regress(options: Options) -> RegressionResult:
    """Do what the options say, and write ``records.json`` and ``index.html``.

    Raises:
        InputError: for a bad matrix, an unknown scene, light or renderer, or references that do not fit.
    """
    if options.update + options.planted + bool(options.clean) > 1:
        raise InputError("--update, --plant and --clean-runs: more than one found; each is a run of its own")
    given = read_spec(options.config)
    spec = choose_pairs(given, options.scenes, options.lights, options.renderers)
    if options.renderers is None:
        foreign = tuple(name for name in renderers() if not is_built_in(name) and name not in spec.renderers)
        spec = RegressSpec(**{**vars(spec), "renderers": (*spec.renderers, *foreign)})
    for name in spec.renderers:
        check_renderer(name)
    folder = output_dir(options.out)
    if options.update:
        return _update(spec, options)
    library = References(options.references, across_versions=options.across_versions)
    if options.planted:
        return _plant(given, library, folder, options)
    if options.clean:
        return _clean(given, library, folder, options)
    return _matrix(spec, library, folder, options)


def _matrix(spec: RegressSpec, library: References, folder: Path, options: Options) -> RegressionResult:
    begin = time.perf_counter()
    with progress_bar("comparing", _pairs(spec)) as advance:
        rows = run_matrix(spec, library, seed=options.seed, on_row=lambda _: advance())
    evidence = [gather_evidence(row, folder) for row in rows if row.verdict == "differs"]
    seconds = time.perf_counter() - begin
    records = matrix_records(rows, seconds, options.command, options.seed)
    lead = page.lead_text(rows, spec)
    _write(folder, lead, page.page_sections(rows, evidence[:_SHOWN], spec), records)
    lines = [lead, *(f"{e.row.renderer}, {e.row.scene}, {e.row.light}: {e.cause}" for e in evidence)]
    lines += [f"{r.renderer}, {r.scene}, {r.light}: {r.detail}" for r in rows if r.verdict == "failed"]
    ok = all(row.verdict in ("agrees", "not installed") for row in rows)
    return RegressionResult(records, ok, "\n".join([*lines, f"report: {folder / 'index.html'}"]))


def _update(spec: RegressSpec, options: Options) -> RegressionResult:
    begin = time.perf_counter()
    scenes = [(s, lights) for s, lights in load_subjects(spec) if not has_closed_form(s.spec)]
    files = sum(1 + len(lights) for _, lights in scenes)
    with progress_bar("references", files) as advance:
        make_references(
            spec,
            options.references,
            scenes,
            lambda subject: models_of_renderers(spec.renderers, subject),
            advance,
        )
    size = sum(path.stat().st_size for path in options.references.glob("*.exr")) / 1e6
    found = [
        make_record("regress.update.files", files, "1", command=options.command),
        make_record("regress.update.seconds", time.perf_counter() - begin, "s", command=options.command),
        make_record("regress.update.size", size, "MB", command=options.command),
    ]
    return RegressionResult(found, True, f"{files} references in {options.references}, {size:.1f} MB")


def _plant(spec: RegressSpec, library: References, folder: Path, options: Options) -> RegressionResult:
    with progress_bar("planting", fault_injection.fault_sizes()) as advance:
        found = fault_injection.inject_faults(spec, library, _pairs(spec), seed=options.seed, on_step=advance)
    records = fault_records(found, options.command, options.seed)
    section = page.fault_section(found, spec)
    caught = sum(item.caught for item in found)
    lead = f"{caught} of {len(found)} planted defects were seen."
    _write(folder, lead, [section], records)
    missed = [f"not seen: {item.defect.words}, in {item.host}" for item in found if not item.caught]
    text = "\n".join([lead, *missed, f"report: {folder / 'index.html'}"])
    return RegressionResult(records, not missed, text)


def _clean(spec: RegressSpec, library: References, folder: Path, options: Options) -> RegressionResult:
    with progress_bar("clean runs", options.clean) as advance:
        chances = fault_injection.repeat_clean_runs(spec, library, options.clean, on_step=advance)
    records = clean_records(chances, options.command)
    lead = (
        f"{len(chances)} comparisons with nothing wrong: {records[1].value:.1%} were refused at a level "
        f"of {_COUNTED:.0%}."
    )
    _write(folder, lead, [page.clean_section(chances)], records)
    low = records[1].interval
    assert low is not None
    return RegressionResult(records, low[0] <= _COUNTED, f"{lead}\nreport: {folder / 'index.html'}")


def matrix_records(rows: Sequence[Row], seconds: float, command: str, seed: int) -> list[Record]:
    """Counts, and the worst z, p and time of every pair."""
    counts = {
        "pairs": sum(row.agreement is not None for row in rows),
        "differing": sum(row.verdict == "differs" for row in rows),
        "failed": sum(row.verdict == "failed" for row in rows),
        "not_installed": sum(row.verdict == "not installed" for row in rows),
    }
    found = [
        make_record(f"regress.{name}", value, "1", command=command, seed=seed)
        for name, value in counts.items()
    ]
    found.append(make_record("regress.seconds", seconds, "s", command=command, seed=seed))
    for row in rows:
        if row.agreement is None:
            continue
        key = f"regress.{_word(row.renderer)}.{_word(row.scene)}.{_word(row.light)}"
        numbers = {"worst_z": (row.agreement.worst_z, "1"), "p": (row.p, "1"), "seconds": (row.seconds, "s")}
        for name, (value, unit) in numbers.items():
            found.append(make_record(f"{key}.{name}", value, unit, command=command, seed=seed))
    return found


def fault_records(found: Sequence[fault_injection.FaultDetection], command: str, seed: int) -> list[Record]:
    """How many were planted and caught, and the smallest size of each kind that was."""
    kinds = dict.fromkeys(item.defect.kind for item in found)
    caught = [kind for kind in kinds if all(item.caught for item in found if item.defect.kind == kind)]
    records = [
        make_record("regress.defects_planted", len(kinds), "1", command=command, seed=seed),
        make_record("regress.defects_caught", len(caught), "1", command=command, seed=seed),
    ]
    for item in found:
        if item.smallest is not None:
            what = f"regress.smallest.{item.defect.kind}{item.suffix}"
            records.append(make_record(what, item.smallest, item.defect.unit, command=command, seed=seed))
    return records


def clean_records(chances: Sequence[float], command: str) -> list[Record]:
    """How often clean pairs were refused."""
    refused = sum(p < _COUNTED for p in chances)
    ends = binomtest(refused, len(chances)).proportion_ci()
    return [
        make_record("regress.clean.pairs", len(chances), "1", command=command),
        make_record(
            "regress.clean.refused_at_5_percent",
            refused / len(chances),
            "1",
            command=command,
            interval=(ends.low, ends.high),
        ),
    ]


def _write(folder: Path, lead: str, sections: Sequence[Section], records: Sequence[Record]) -> None:
    write_records(folder / "records.json", records)
    write_page(folder / "index.html", "Do the renderers agree?", lead, sections, footer=page.page_footer())


def _pairs(spec: RegressSpec) -> int:
    return len(spec.renderers) * sum(len(pair.lights) for pair in spec.scenes)


def _word(name: str) -> str:
    """A name as one word of a record; our own stay as they are."""
    return (
        name if is_built_in(name) or name.replace("_", "").replace("-", "").isalnum() else dotted_word(name)
    )
