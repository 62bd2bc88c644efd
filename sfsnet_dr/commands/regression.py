"""The command that holds renderers to what they should show."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from sfsnet_dr.commands.result import Json, Out, Result, command_line


@dataclass(frozen=True)
class Regress:
    """Hold every renderer to what it should show, and say where one differs and why.

    Renderers of other packages (entry points ``sfsnet_dr.renderers``) are compared too. The exit code is 0 if
    all agree, 1 if any differs or fails, 2 for bad input, such as references of another scene.

    Example: sfsnet-dr regress --out out/regress
    """

    out: Out = Path("out/regress")
    renderers: Annotated[str | None, arg(metavar="A,B", help="Only these; any installed one.")] = None
    scenes: Annotated[str | None, arg(metavar="A,B", help="Only these scenes of the matrix.")] = None
    lights: Annotated[str | None, arg(metavar="A,B", help="Only these lights of the matrix.")] = None
    plant: Annotated[
        bool, arg(help="Plant defects, see whether each is caught, and how small it may be.")
    ] = False
    clean_runs: Annotated[int, arg(metavar="N", help="Repeat clean runs N times and count false alarms.")] = 0
    update: Annotated[bool, arg(help="Make the stored references again, and nothing else.")] = False
    across_versions: Annotated[
        bool, arg(help="Take references made by another version of Mitsuba, to compare the two.")
    ] = False
    config: Annotated[
        Path | None, arg(metavar="FILE", help="The matrix; eval/regress.toml of the checkout.")
    ] = None
    references: Annotated[
        Path | None, arg(metavar="DIR", help="The references; eval/references of the checkout.")
    ] = None
    seed: Annotated[int, arg(help="Seed of the noise; another one gives independent images.")] = 0
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.report.record import to_json
        from sfsnet_dr.study.regress.run import Options, regress
        from sfsnet_dr.study.regress.spec import CONFIG, REFERENCES

        done = regress(
            Options(
                out=self.out,
                config=self.config or CONFIG,
                references=self.references or REFERENCES,
                scenes=self.scenes,
                lights=self.lights,
                renderers=self.renderers,
                seed=self.seed,
                update=self.update,
                planted=self.plant,
                clean=self.clean_runs,
                across_versions=self.across_versions,
                command=command_line(),
            )
        )
        return Result(text=done.text, json=to_json(done.records), code=0 if done.ok else 1)
