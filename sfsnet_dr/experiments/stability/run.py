"""``sfsnet-dr stability``: every case on every backend, as records and a page."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Final

from sfsnet_dr.core import provenance
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import output_dir, write_text
from sfsnet_dr.experiments.stability import cases as hard_numbers
from sfsnet_dr.experiments.stability import layouts
from sfsnet_dr.experiments.stability.backends import FORMS, STRICT_FORMS
from sfsnet_dr.experiments.stability.cases import Bound, Case, ExpectedNonFinite
from sfsnet_dr.experiments.stability.child import PROCESS_CASES
from sfsnet_dr.experiments.stability.compare import DTYPES, Outcome, compare_with_expected
from sfsnet_dr.experiments.stability.isolated import cases_in_subprocess, run_in_subprocess
from sfsnet_dr.experiments.stability.process_case import Finding, ProcessCase
from sfsnet_dr.report.console import progress_bar
from sfsnet_dr.report.html import Block, KeyNumbers, Note, Section, Table, write_page
from sfsnet_dr.report.record import Record, dotted_word, make_record, write_records

#: Cases that run here.
NUMBER_CASES: Final = (*hard_numbers.CASES, *layouts.CASES)


@dataclass(frozen=True)
class StabilityResult:
    """All cases that were run, with what came out.

    Attributes:
        numbers: hard numbers and hard memory, each with its outcomes of all forms and precisions.
        processes: cases in processes of their own, each with its findings by form.
    """

    numbers: list[tuple[Case, list[Outcome]]]
    processes: list[tuple[ProcessCase, dict[str, Finding]]]

    @property
    def cases(self) -> int:
        """Number of cases."""
        return len(self.numbers) + len(self.processes)

    @property
    def checks(self) -> int:
        """Number of verdicts: cases times forms times precisions."""
        return sum(len(o) for _, o in self.numbers) + sum(len(f) for _, f in self.processes)

    def failures(self) -> list[str]:
        """One line for each verdict that is a failure."""
        lines = [
            f"{o.form}, {o.dtype}: {o.group}: {o.case}: {o.problem}"
            for _, outcomes in self.numbers
            for o in outcomes
            if o.problem
        ]
        return lines + [
            f"{form}: {case.name}: {finding.problem}"
            for case, findings in self.processes
            for form, finding in findings.items()
            if finding.problem
        ]


def run_stability(
    out: Path | str, only: str = "", *, command: str = "sfsnet-dr stability"
) -> tuple[StabilityResult, list[Record]]:
    """Run the cases and write ``records.json``, ``cases.csv`` and ``index.html``.

    Args:
        out: folder for the results.
        only: run the cases whose "group: name" holds this text, in any case of letters.
        command: what the records say measured them.

    Raises:
        InputError: if no case holds the text, or for a bad folder.
    """

    numbers, processes = _chosen(only)
    folder = output_dir(out)
    steps = len(numbers) + sum(len(cases_in_subprocess(case)) for case in processes)
    with progress_bar("cases", steps) as step:
        study = StabilityResult(
            [(case, _judged(case, step)) for case in numbers],
            [(case, _isolated(case, step)) for case in processes],
        )
    found = stability_records(study, command)
    write_records(folder / "records.json", found)
    write_text(folder / "cases.csv", to_csv(study))
    write_stability_page(folder / "index.html", study)
    return study, found


def stability_records(study: StabilityResult, command: str) -> list[Record]:
    """Cases, failures, the worst errors of every form and precision, memory and kernels."""

    def record(what: str, value: float, unit: str) -> Record:
        return make_record(f"stability.{what}", value, unit, command=command)

    found = [
        record("cases", study.cases, "cases"),
        record("checks", study.checks, "checks"),
        record("failures", len(study.failures()), "checks"),
    ]
    for form in FORMS:
        for dtype in DTYPES:
            for what, value in worst_outcome(study, form.name, dtype).items():
                unit = "ulp" if what.endswith("ulp") else "1"
                found.append(record(f"worst.{dotted_word(form.name)}.{dtype}.{what}", value, unit))
    for case, findings in study.processes:
        for name, finding in findings.items():
            found.append(record(f"{dotted_word(case.name)}.{dotted_word(name)}", finding.figure, case.unit))
    return found


def worst_outcome(study: StabilityResult, form: str, dtype: str) -> dict[str, float]:
    """The worst errors of a form over all cases with a bound; relative ones where nothing underflows.

    Nothing for what the form does not give.
    """
    rows = [
        (case.expect, outcome)
        for case, outcomes in study.numbers
        for outcome in outcomes
        if outcome.form == form and outcome.dtype == dtype and isinstance(case.expect, Bound)
    ]
    if not rows:
        return {}
    plain = [o for expect, o in rows if not expect.floor and not expect.gradient_floor]
    found = {
        "value_ulp": max(o.value_ulp for _, o in rows),
        "value_rel": max((o.value_rel for o in plain), default=0.0),
    }
    if not next(f for f in (*FORMS, *STRICT_FORMS) if f.name == form).differentiable:
        return found
    return found | {
        "gradient_ulp": max(o.gradient_ulp for _, o in rows),
        "gradient_rel": max((o.gradient_rel for o in plain), default=0.0),
    }


def to_csv(study: StabilityResult) -> str:
    """One line for each outcome; those of processes have their figure in place of the errors."""
    text = io.StringIO()
    names = [field.name for field in fields(Outcome)]
    writer = csv.DictWriter(text, [*names, "figure"], lineterminator="\n", restval="")
    writer.writeheader()
    for _, outcomes in study.numbers:
        writer.writerows(asdict(outcome) for outcome in outcomes)
    for case, findings in study.processes:
        for form, finding in findings.items():
            writer.writerow({"form": form, "group": "Processes", "case": case.name} | asdict(finding))
    return text.getvalue()


def _chosen(only: str) -> tuple[list[Case], list[ProcessCase]]:
    def holds(name: str) -> bool:
        return only.lower() in name.lower()

    numbers = [case for case in NUMBER_CASES if holds(f"{case.group}: {case.name}")]
    processes = [case for case in PROCESS_CASES if holds(f"Processes: {case.name}")]
    if not numbers and not processes:
        groups = sorted({case.group for case in NUMBER_CASES} | {"Processes"})
        raise InputError(f"--only {only!r}: no case holds this text; groups are: {', '.join(groups)}")
    return numbers, processes


def _judged(case: Case, step: Callable[[], None]) -> list[Outcome]:
    outcomes = [compare_with_expected(form, case, dtype) for form in FORMS for dtype in DTYPES]
    outcomes += [compare_with_expected(form, case, "float32") for form in STRICT_FORMS]
    step()
    return outcomes


def _isolated(case: ProcessCase, step: Callable[[], None]) -> dict[str, Finding]:
    findings = run_in_subprocess(case)
    for _ in findings:
        step()
    return findings


_HOW = (
    "Each case goes through every spherical-harmonic renderer and every backend of the reconstruction loss, "
    "value and gradients, with inputs of float32, bfloat16 and float64. The answer is compared with float64 "
    "computed in another way from the same, already rounded inputs; every call is made twice and compared "
    "bit for bit.",
    "A cell gives the worst error of the value, then of the gradients, in units in the last place (ulp): the "
    "distance between neighbouring numbers of the result's own type, at the largest magnitude that this "
    "light and albedo can give. So a value that cancels to 0 is not asked for digits that no float32 "
    "computation has. The worst over the three types of inputs is shown; Dr.Jit's cells also cover "
    "float32 with its FastMath flag switched off. `cases.csv` beside this page has every single "
    "number, relative errors too.",
)

_COLUMNS = {
    "value_ulp": "value, ulp",
    "value_rel": "value, relative",
    "gradient_ulp": "gradients, ulp",
    "gradient_rel": "gradients, relative",
}

_LEAD = {
    "Normals": "Directions and lengths of normals.",
    "Light and albedo": "From nothing to far beyond what a photograph holds.",
    "Shape and mask": "The smallest images, empty ones, and masks that leave nothing.",
    "Kinks": "Where a derivative does not exist: the answer must lie between those of both sides.",
    "NaN and inf": (
        "Nothing is hidden: what goes in comes out at the same pixel and in the gradients that it reaches, "
        "and all other numbers stay right. The loss is one number and shows it, masked out or not."
    ),
    "Memory": "The same numbers through views, with gradients for what lies behind the views.",
}


def write_stability_page(path: Path, study: StabilityResult) -> None:
    """Write the page, self-contained."""
    groups = dict.fromkeys(case.group for case, _ in study.numbers)
    sections = [_summary(study), *(_group(study, group) for group in groups)]
    if study.processes:
        sections.append(_processes(study))
    if study.numbers:
        sections.append(_worst(study))
    footer = ", ".join(f"{name} {number}" for name, number in provenance.versions().items())
    write_page(path, "Stability of the renderers and the loss", _lead(study), sections, footer=footer)


def _lead(study: StabilityResult) -> str:
    count = len(study.failures())
    found = "none fails" if count == 0 else f"{count} fail"
    return f"{study.cases} hard cases, {study.checks} checks of value and gradient: {found}."


def _summary(study: StabilityResult) -> Section:
    numbers = KeyNumbers(
        [
            (str(study.cases), "hard cases"),
            (str(study.checks), "checks: cases by renderers by types of input"),
            (str(len(study.failures())), "checks that fail"),
        ]
    )
    failures: list[Block] = [Note(line) for line in study.failures()]
    return Section("How to read this", [numbers, *failures, *_HOW])


def _group(study: StabilityResult, group: str) -> Section:
    rows = [
        [case.name, *(_cell(case, outcomes, form.name) for form in FORMS), _expected(case)]
        for case, outcomes in study.numbers
        if case.group == group
    ]
    headers = ["case", *(form.name for form in FORMS), "expected, and why"]
    return Section(group, [Table(headers, rows, _LEAD[group])])


def _cell(case: Case, outcomes: list[Outcome], form: str) -> str:
    """The worst of a form over precisions and, for Dr.Jit, FastMath."""
    here = [o for o in outcomes if o.form == form or o.form.startswith(f"{form}, ")]
    if any(o.problem for o in here):
        return "FAILS"
    if all(o.refused for o in here):
        return "refused"
    if isinstance(case.expect, ExpectedNonFinite):
        return "shown"
    value, gradient = max(o.value_ulp for o in here), max(o.gradient_ulp for o in here)
    return f"{value:.1f}" if form == "numpy" else _pair(f"{value:.1f}", f"{gradient:.1f}")


def _pair(value: str, gradient: str) -> str:
    """Two numbers that stay on one line."""
    return f"{value}\u00a0/\u00a0{gradient}"


def _expected(case: Case) -> str:
    expect = case.expect
    if isinstance(expect, Bound):
        bound = f"at most {_pair(f'{expect.value:g}', f'{expect.gradient:g}')} ulp"
        if expect.floor or expect.gradient_floor:
            floors = _pair(f"{expect.floor:.1g}", f"{expect.gradient_floor:.1g}")
            bound += f" more than an absolute error of {floors}"
    elif isinstance(expect, ExpectedNonFinite):
        bound = "not hidden"
    else:
        bound = f"InputError: “{expect.words}”"
    return f"{bound}; {case.cause}"


def _processes(study: StabilityResult) -> Section:
    rows = []
    for case, findings in study.processes:
        cells = [_finding(case, findings.get(form.name)) for form in FORMS]
        rows.append([case.name, *cells, f"{case.expected}; {case.cause}"])
    headers = ["case", *(form.name for form in FORMS), "expected, and why"]
    caption = (
        "Each case runs in a process of its own with a time limit, so that a crash or a hang is one failed "
        "cell. A dash: not about this form."
    )
    return Section("Calls, threads and processes", [Table(headers, rows, caption)])


def _finding(case: ProcessCase, finding: Finding | None) -> str:
    if finding is None:
        return "–"  # noqa: RUF001
    if finding.problem:
        return "FAILS"
    if finding.refused:
        return "refused"
    if case.unit == "results":
        return "same"
    return f"{finding.figure:.3g} {case.unit}"


def _worst(study: StabilityResult) -> Section:
    rows = []
    for form in FORMS:
        for dtype in DTYPES:
            found = worst_outcome(study, form.name, dtype)
            cells = [_number(found, what) for what in _COLUMNS]
            rows.append([form.name, dtype, *cells])
    headers = ["form", "inputs", *_COLUMNS.values()]
    caption = (
        "Over all cases that have a bound. Relative: over the largest entry of the image or gradient, cases "
        "with denormal numbers left out. A bfloat16 gradient is rounded to 8 bits, which alone is up to "
        "0.0039; values of bfloat16 inputs are float32, and NumPy always computes in float64."
    )
    return Section("Worst errors by type of input", [Table(headers, rows, caption)])


def _number(found: dict[str, float], what: str) -> str:
    if what not in found:
        return "–"  # noqa: RUF001
    return f"{found[what]:.2f}" if what.endswith("ulp") else f"{found[what]:.1e}"
