"""Run a case in a child with a time limit, and tell which form ended or stopped it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Sequence
from typing import Final

from sfsnet_dr.experiments.stability.backends import FORMS, ComputeBackend
from sfsnet_dr.experiments.stability.process_case import Finding, ProcessCase

#: What Python runs in a child; the names of case and forms follow.
CHILD: Final = ("-m", "sfsnet_dr.experiments.stability.child")


def cases_in_subprocess(case: ProcessCase) -> list[ComputeBackend]:
    """The forms that a case is about."""
    return [
        form
        for form in FORMS
        if (form.jit or not case.jit_only) and (form.differentiable or not case.differentiable_only)
    ]


def run_in_subprocess(case: ProcessCase) -> dict[str, Finding]:
    """Findings of every form concerned, by its name.

    A child that dies or hangs is the failure of the form that it had; the others go on in a new one.
    """
    left = [form.name for form in cases_in_subprocess(case)]
    findings: dict[str, Finding] = {}
    while left:
        names = left[:1] if case.alone else left
        found, end = _child(case, names)
        findings |= dict(zip(names, found, strict=False))
        if len(found) < len(names):
            findings[names[len(found)]] = Finding(0, end)
        left = [name for name in left if name not in findings]
    return findings


def _child(case: ProcessCase, names: Sequence[str]) -> tuple[list[Finding], str]:
    """The findings that came, and how the child ended."""
    command = [sys.executable, *CHILD, case.name, *names]
    limit = case.limit * len(names)
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired as late:
        output = late.stdout.decode() if isinstance(late.stdout, bytes) else (late.stdout or "")
        return _findings(output), f"no answer in {limit:g} s"
    return _findings(done.stdout), _end(done.returncode, done.stderr)


def _findings(output: str) -> list[Finding]:
    return [Finding(**json.loads(line)) for line in output.splitlines() if line.startswith("{")]


def _end(code: int, errors: str) -> str:
    lines = errors.strip().splitlines()
    how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
    return f"{how}: {lines[-1]}" if lines else how
