"""The first commands that a user runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from sfsnet_dr.cli.common import Json, Out, Result, result_of_records


@dataclass(frozen=True)
class Doctor:
    """Compile a kernel and render a tiny scene in a process of its own, and report what was found.

    Ends with exit code 1 if anything fails, an abort of the process included.

    Example: sfsnet-dr doctor
    """

    as_json: Annotated[bool, arg(name="json", help="Print the report as JSON, nothing else.")] = False

    def run(self) -> Result:
        from sfsnet_dr.experiments.doctor import check_installation

        report = check_installation()
        return Result(text=report.to_text(), json=report.to_json(), code=0 if report.ok else 1)


@dataclass(frozen=True)
class Demo:
    """The whole pipeline, in minutes: check, render, measure, train, decompose, and one HTML report.

    Example: sfsnet-dr demo --out out/demo
    """

    out: Out = Path("out/demo")
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.experiments.demo.run import run_demo

        return result_of_records(run_demo(self.out), f"report: {self.out / 'index.html'}")
