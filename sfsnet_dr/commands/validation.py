"""The command that measures renderers on a scene."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from sfsnet_dr.commands.result import Json, Out, Result, command_line, of_records


@dataclass(frozen=True)
class Validate:
    """Measure the order-2 spherical-harmonic renderer against the path tracer: error and time of a scene.

    Example: sfsnet-dr validate scenes/validation/sphere.toml --out out/validate
    """

    scene: Positional[Annotated[Path, arg(metavar="SCENE", help="Scene (TOML) of the folder scenes/.")]]
    out: Out
    tolerance: Annotated[
        float | None,
        arg(metavar="RATIO", help="Relative RMS error of order 2 above which the exit code is 1."),
    ] = None
    seed: Annotated[int, arg(help="Seed of the head and of the path tracer's noise.")] = 0
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.study.validate import validate

        records = validate(self.scene, self.out, self.tolerance, seed=self.seed, command=command_line())
        return of_records(records, f"report: {self.out / 'index.html'}")
