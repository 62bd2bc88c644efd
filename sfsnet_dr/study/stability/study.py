"""``sfsnet-dr stability``: every case on every form, as records, a table and a page."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Final

from sfsnet_dr.base.atomic import output_dir, write_text
from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.report.console import bar
from sfsnet_dr.report.record import Record, dotted, measured, write_records
from sfsnet_dr.study.stability import hard_numbers, layouts
from sfsnet_dr.study.stability.case import Bound, Case
from sfsnet_dr.study.stability.child import PROCESS_CASES
from sfsnet_dr.study.stability.forms import FORMS, STRICT_FORMS
from sfsnet_dr.study.stability.isolated import concerned, run_isolated
from sfsnet_dr.study.stability.judge import DTYPES, Outcome, judge
from sfsnet_dr.study.stability.process_case import Finding, ProcessCase

#: Cases that run here.
NUMBER_CASES: Final = (*hard_numbers.CASES, *layouts.CASES)


@dataclass(frozen=True)
class Study:
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


def stability(
    out: Path | str, only: str = "", *, command: str = "sfsnet-dr stability"
) -> tuple[Study, list[Record]]:
    """Run the cases and write ``records.json``, ``cases.csv`` and ``index.html``.

    Args:
        out: folder for the results.
        only: run the cases whose "group: name" holds this text, in any case of letters.
        command: what the records say measured them.

    Raises:
        BadInput: if no case holds the text, or for a bad folder.
    """
    from sfsnet_dr.study.stability.page import write_stability_page

    numbers, processes = _chosen(only)
    folder = output_dir(out)
    steps = len(numbers) + sum(len(concerned(case)) for case in processes)
    with bar("cases", steps) as step:
        study = Study(
            [(case, _judged(case, step)) for case in numbers],
            [(case, _isolated(case, step)) for case in processes],
        )
    found = records(study, command)
    write_records(folder / "records.json", found)
    write_text(folder / "cases.csv", to_csv(study))
    write_stability_page(folder / "index.html", study)
    return study, found


def records(study: Study, command: str) -> list[Record]:
    """Cases, failures, the worst errors of every form and precision, memory and kernels."""

    def record(what: str, value: float, unit: str) -> Record:
        return measured(f"stability.{what}", value, unit, command=command)

    found = [
        record("cases", study.cases, "cases"),
        record("checks", study.checks, "checks"),
        record("failures", len(study.failures()), "checks"),
    ]
    for form in FORMS:
        for dtype in DTYPES:
            for what, value in worst(study, form.name, dtype).items():
                unit = "ulp" if what.endswith("ulp") else "1"
                found.append(record(f"worst.{dotted(form.name)}.{dtype}.{what}", value, unit))
    for case, findings in study.processes:
        for name, finding in findings.items():
            found.append(record(f"{dotted(case.name)}.{dotted(name)}", finding.figure, case.unit))
    return found


def worst(study: Study, form: str, dtype: str) -> dict[str, float]:
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


def to_csv(study: Study) -> str:
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
        raise BadInput(f"--only {only!r}: no case holds this text; groups are: {', '.join(groups)}")
    return numbers, processes


def _judged(case: Case, step: Callable[[], None]) -> list[Outcome]:
    outcomes = [judge(form, case, dtype) for form in FORMS for dtype in DTYPES]
    outcomes += [judge(form, case, "float32") for form in STRICT_FORMS]
    step()
    return outcomes


def _isolated(case: ProcessCase, step: Callable[[], None]) -> dict[str, Finding]:
    findings = run_isolated(case)
    for _ in findings:
        step()
    return findings
