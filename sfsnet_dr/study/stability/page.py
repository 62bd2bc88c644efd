"""The page of ``sfsnet-dr stability``: all cases, what was expected, the worst error of every form."""

from __future__ import annotations

from pathlib import Path

from sfsnet_dr.base import provenance
from sfsnet_dr.report.html import Block, KeyNumbers, Note, Section, Table, write_page
from sfsnet_dr.study.stability.case import Bound, Case, NotFinite
from sfsnet_dr.study.stability.forms import FORMS
from sfsnet_dr.study.stability.judge import DTYPES, Outcome
from sfsnet_dr.study.stability.process_case import Finding, ProcessCase
from sfsnet_dr.study.stability.study import Study, worst

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


def write_stability_page(path: Path, study: Study) -> None:
    """Write the page, self-contained."""
    groups = dict.fromkeys(case.group for case, _ in study.numbers)
    sections = [_summary(study), *(_group(study, group) for group in groups)]
    if study.processes:
        sections.append(_processes(study))
    if study.numbers:
        sections.append(_worst(study))
    footer = ", ".join(f"{name} {number}" for name, number in provenance.versions().items())
    write_page(path, "Stability of the renderers and the loss", _lead(study), sections, footer=footer)


def _lead(study: Study) -> str:
    count = len(study.failures())
    found = "none fails" if count == 0 else f"{count} fail"
    return f"{study.cases} hard cases, {study.checks} checks of value and gradient: {found}."


def _summary(study: Study) -> Section:
    numbers = KeyNumbers(
        [
            (str(study.cases), "hard cases"),
            (str(study.checks), "checks: cases by renderers by types of input"),
            (str(len(study.failures())), "checks that fail"),
        ]
    )
    failures: list[Block] = [Note(line) for line in study.failures()]
    return Section("How to read this", [numbers, *failures, *_HOW])


def _group(study: Study, group: str) -> Section:
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
    if isinstance(case.expect, NotFinite):
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
    elif isinstance(expect, NotFinite):
        bound = "not hidden"
    else:
        bound = f"BadInput: “{expect.words}”"
    return f"{bound}; {case.cause}"


def _processes(study: Study) -> Section:
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


def _worst(study: Study) -> Section:
    rows = []
    for form in FORMS:
        for dtype in DTYPES:
            found = worst(study, form.name, dtype)
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
