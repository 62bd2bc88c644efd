"""The hard cases: all forms pass them, and forms with one planted fault each are caught."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.experiments.stability import child, isolated, run
from sfsnet_dr.experiments.stability.backends import FORMS, STRICT_FORMS, ComputeBackend, Inputs, find_backend
from sfsnet_dr.experiments.stability.cases import Case
from sfsnet_dr.experiments.stability.compare import DTYPES, compare_with_expected
from sfsnet_dr.experiments.stability.isolated import cases_in_subprocess, run_in_subprocess
from sfsnet_dr.experiments.stability.process_case import Finding, ProcessCase
from sfsnet_dr.report.record import read_records

CASES = {f"{case.group}: {case.name}": case for case in run.NUMBER_CASES}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_every_form_passes_in_float32(case: Case) -> None:
    outcomes = [compare_with_expected(form, case, "float32") for form in FORMS]
    assert [o.problem for o in outcomes if o.problem] == []


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_every_form_passes(case: Case) -> None:
    outcomes = [compare_with_expected(form, case, dtype) for form in FORMS for dtype in DTYPES]
    outcomes += [compare_with_expected(form, case, "float32") for form in STRICT_FORMS]
    assert [o.problem for o in outcomes if o.problem] == []


@pytest.mark.slow
@pytest.mark.parametrize("case", child.PROCESS_CASES, ids=lambda case: case.name)
def test_every_form_passes_in_processes(case: ProcessCase) -> None:
    findings = run_in_subprocess(case)
    assert set(findings) == {form.name for form in cases_in_subprocess(case)}
    assert [f.problem for f in findings.values() if f.problem] == []


def test_names_tell_cases_apart() -> None:
    assert len(CASES) == len(run.NUMBER_CASES)
    assert len({case.name for case in child.PROCESS_CASES}) == len(child.PROCESS_CASES)


def _planted(change: Callable[[Inputs, Tensor], Tensor], of: str = "torch") -> ComputeBackend:
    """A form whose result is changed."""
    good = find_backend(of)
    return ComputeBackend("wrong", good.kind, lambda inputs: change(inputs, good.call(inputs)))


def _squared_too_soon(inputs: Inputs, image: Tensor) -> Tensor:
    """Normalises without care for long normals."""
    direction = inputs.normal / (inputs.normal.square().sum(1, keepdim=True)).sqrt().clamp_min(1e-6)
    return find_backend("torch").call(inputs._replace(normal=direction))


def _kinked(inputs: Inputs, loss: Tensor) -> Tensor:
    """The slope of |x| at 0 is 1."""
    difference = inputs.image.detach() - find_backend("torch").call(inputs)
    absolute = torch.where(difference >= 0, difference, -difference)
    mask = inputs.mask.detach()
    return (mask * absolute).sum() / (3 * mask.sum()).clamp_min(1)


def _drifting() -> ComputeBackend:
    """Gives a little more with every call."""
    calls = iter(range(1, 1000))
    return _planted(lambda _, image: image * (1 + 1e-6 * next(calls)))


#: A fault, and a case and a precision that it is caught by.
PLANTED = {
    "clamped": (_planted(lambda _, image: image.clamp_min(0)), "Light and albedo: ringing, shading below 0"),
    "NaN hidden": (_planted(lambda _, image: image.nan_to_num()), "NaN and inf: nan in normal, counted"),
    "NaN spread": (_planted(lambda _, image: image + 0 * image.sum()), "NaN and inf: nan in albedo, counted"),
    "overflow": (_planted(_squared_too_soon), "Normals: lengths 1e10 to 1e37"),
    "rounded": (_planted(lambda _, image: image.bfloat16().float()), "Normals: along the axes and the poles"),
    "4e-6 off": (_planted(lambda _, image: image * (1 + 4e-6)), "Light and albedo: light 1e8"),
    "gradient off": (
        _planted(lambda i, image: image + 1e-4 * (i.light.sum() - i.light.sum().detach())),
        "Shape and mask: image 1 x 1",
    ),
    "kink": (_planted(_kinked, "loss torch"), "Kinks: residual 0 where albedo and image are black"),
    "other bits": (_drifting(), "Shape and mask: 17 images of 1 x 3"),
    "wrong shape": (_planted(lambda _, image: image[:1]), "Memory: one light for a batch"),
    "takes nothing": (
        ComputeBackend("wrong", "render", lambda i: (i.albedo * i.normal).sum(1, keepdim=True)),
        "Shape and mask: empty batch",
    ),
    "raises": (_planted(lambda *_: [][0]), "Light and albedo: light 0"),
}  # fmt: skip


@pytest.mark.parametrize("fault", PLANTED)
def test_a_planted_fault_is_caught(fault: str) -> None:
    form, name = PLANTED[fault]
    assert compare_with_expected(form, CASES[name], "float32").problem
    assert not compare_with_expected(find_backend("torch"), CASES[name], "float32").problem


def test_a_crash_is_one_failed_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    found = _run_planted("os.abort()", monkeypatch)
    assert found["torch"].problem == "killed by SIGABRT"
    assert [name for name, finding in found.items() if finding.problem] == ["torch"]
    assert set(found) == {form.name for form in FORMS}


def test_a_hang_is_one_failed_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    found = _run_planted("time.sleep(100)", monkeypatch)
    assert found["torch"].problem == "no answer in 1 s"
    assert [name for name, finding in found.items() if finding.problem] == ["torch"]


def _run_planted(fault: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, Finding]:
    """A child that answers at once for every form but one."""
    code = f"""
import json, os, sys, time
for name in sys.argv[2:]:
    if name == "torch":
        {fault}
    print(json.dumps({{"figure": 1}}), flush=True)
"""
    monkeypatch.setattr(isolated, "CHILD", ("-c", code))
    return run_in_subprocess(ProcessCase("planted", "", "", lambda _: Finding(1), alone=True, limit=1))


def test_the_command_writes_records_table_and_page(tmp_path: Path) -> None:
    found, records = run.run_stability(tmp_path, "axes and the poles")
    assert found.cases == 1
    assert found.checks == len(FORMS) * len(DTYPES) + len(STRICT_FORMS)
    assert found.failures() == []
    values = {record.what: record.value for record in records}
    assert values["stability.cases"] == 1
    assert values["stability.failures"] == 0
    assert 0 < values["stability.worst.loss_drjit.bfloat16.gradient_rel"] < 0.004
    assert [record.what for record in read_records(tmp_path / "records.json")] == list(values)
    assert "along the axes and the poles" in (tmp_path / "index.html").read_text(encoding="utf-8")
    assert len((tmp_path / "cases.csv").read_text(encoding="utf-8").splitlines()) == 1 + found.checks


def test_a_failure_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from sfsnet_dr.cli.main import main

    wrong, name = PLANTED["clamped"]
    monkeypatch.setattr(run, "FORMS", (wrong,))
    monkeypatch.setattr(run, "STRICT_FORMS", ())
    code = main(["stability", "--out", str(tmp_path), "--only", name, "--json"])
    values = {row["what"]: row["value"] for row in json.loads(capsys.readouterr().out)}
    assert code == 1
    assert values["stability.failures"] == 3
    assert "off by" in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_unknown_case_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--only 'moon': no case holds this text; groups are: Kinks"):
        run.run_stability(tmp_path, "moon")


def test_truth_by_finite_differences() -> None:
    """The oracle's own gradients, which the forms are judged by."""
    from sfsnet_dr.experiments.stability.cases import default_case
    from sfsnet_dr.experiments.stability.expected import Array, ExpectedResult, expected_loss

    leaves = default_case(np.random.default_rng(1), 1, 3, 2)
    leaves["normal"] *= 0.7
    names, step = ("normal", "albedo", "light", "image", "mask"), 1e-6

    def truth(changed: dict[str, Array]) -> ExpectedResult:
        normal, albedo, light, image, mask = (changed[n] for n in names)
        return expected_loss(normal, albedo, light, image, mask)

    exact = truth(leaves).grads
    for name, gradient in zip(names, exact, strict=False):
        for at in np.ndindex(gradient.shape):
            ends = []
            for sign in (1, -1):
                moved = leaves[name].copy()
                moved[at] += sign * step
                ends.append(float(truth(leaves | {name: moved}).value))
            # Truncation 1e-12 times third derivatives of about 10, round-off 1e-10.
            assert gradient[at] == pytest.approx((ends[0] - ends[1]) / (2 * step), abs=2e-9)
