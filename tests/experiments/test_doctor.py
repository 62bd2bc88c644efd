from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from sfsnet_dr.core import runtime
from sfsnet_dr.experiments import doctor
from sfsnet_dr.experiments.doctor import STEPS, Check, check_installation, run_probe

FIRST_STEP = (
    'import os, sys, time; print(\'{"name": "variant", "ok": true, "detail": "fine"}\', flush=True); '
)


def probe(code: str, time_limit: float = 30) -> list[Check]:
    return run_probe([sys.executable, "-c", FIRST_STEP + code], time_limit)


def test_this_installation_is_well() -> None:
    report = check_installation()
    assert report.ok, report.to_text()
    assert [check.name for check in report.checks] == ["packages", "llvm", *STEPS]
    told = json.loads(report.to_json())
    assert told["ok"] is True
    assert told["variant"] == "llvm_ad_rgb"
    assert int(told["llvm"]["version"].split(".")[0]) >= 16
    assert told["checks"][2]["values"]["threads"] >= 1
    assert "mitsuba" in told["versions"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no signals")
def test_an_abort_is_a_line_in_the_report() -> None:
    """As an old LLVM does it: a message on standard error, then SIGABRT in the middle of a step."""
    checks = probe("print('LLVM ERROR: Cannot select: fminimum', file=sys.stderr, flush=True); os.abort()")
    assert [check.ok for check in checks] == [True, False, False]
    assert checks[1].name == "kernel"
    assert "SIGABRT: LLVM ERROR: Cannot select: fminimum" in checks[1].detail
    assert checks[2].detail == "not run: kernel failed"


def test_an_early_exit() -> None:
    checks = probe("sys.exit(3)")
    assert "exit code 3 before this step" in checks[1].detail


def test_a_hang_ends_at_the_time_limit() -> None:
    checks = probe("time.sleep(60)", time_limit=1.5)
    assert checks[0].ok
    assert "no answer within 1.5 s" in checks[1].detail


def test_noise_between_the_lines_is_skipped() -> None:
    checks = probe("print('hello'); print('3'); print('{\"name\": 1}')")
    assert [check.ok for check in checks] == [True, False, False]


def test_a_step_that_fails_is_told_by_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from sfsnet_dr.render import probe as steps

    def broken() -> steps.Finding:
        raise RuntimeError("first line\nlast line")

    monkeypatch.setitem(steps.STEPS, "kernel", broken)
    assert doctor._probe() == 0
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [check["ok"] for check in told] == [True, False, True]
    assert told[1]["detail"] == "RuntimeError: last line"


def test_an_old_llvm_is_reported_and_nothing_is_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old = tmp_path / "libLLVM-15.so.1"
    old.touch()
    monkeypatch.setattr(runtime, "_chosen", None)
    monkeypatch.setenv(runtime.LLVM_VARIABLE, str(old))
    report = check_installation()
    assert not report.ok
    assert json.loads(report.to_json())["ok"] is False
    details = {check.name: check.detail for check in report.checks}
    assert "LLVM 15 found" in details["llvm"]
    assert runtime.LLVM_COMMAND in details["llvm"]
    assert details["render"] == "not run: no good LLVM"


def test_missing_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "PACKAGES", ("numpy", "no-such-package", runtime.LLVM_PACKAGE))
    check = doctor._check_packages({"numpy": "2"})
    assert not check.ok
    assert check.detail == "no-such-package not installed: pip install no-such-package"


def test_a_wrong_derivative_or_picture_would_be_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The probe compares with closed forms: change one of them and the step fails."""
    from sfsnet_dr.core.errors import RunError
    from sfsnet_dr.render import probe as steps

    steps.start()
    real = steps._check
    monkeypatch.setattr(steps, "_check", lambda name, found, expected: real(name, found, expected * 1.001))
    for step in (steps.kernel, steps.render):
        with pytest.raises(RunError, match="expected"):
            step()
