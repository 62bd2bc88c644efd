"""The command that puts hard cases to the renderers and the loss."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from sfsnet_dr.commands.result import Json, Out, Result, command_line, of_records


@dataclass(frozen=True)
class Stability:
    """Put hard cases to every spherical-harmonic renderer and the loss; exit code 1 if one fails.

    Example: sfsnet-dr stability --only normals
    """

    out: Out = Path("out/stability")
    only: Annotated[
        str, arg(metavar="TEXT", help='Run the cases whose "group: name" holds this text; all if empty.')
    ] = ""
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.study.stability.study import stability

        study, records = stability(self.out, self.only, command=command_line())
        failures = study.failures()
        lines = [f"FAILED {line}" for line in failures]
        result = of_records(records, *lines, f"report: {self.out / 'index.html'}")
        return replace(result, code=1 if failures else 0)
