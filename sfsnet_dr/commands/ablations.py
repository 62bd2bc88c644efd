"""The command that measures what each part of the method is worth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from sfsnet_dr.commands.result import Json, Out, Result, command_line, of_records


@dataclass(frozen=True)
class Ablations:
    """Train networks that differ in one thing each and measure them alike: OUT/index.html shows the outcome.

    Renders a few faces for each scene, trains a small network for each variant of FILE, and measures all of
    them on the same held-back rendered faces. The same command goes on where it was stopped; what is done is
    not done again. Variants that lack their data are left out, and told.

    Example: sfsnet-dr ablations training/ablations.toml --out out/ablations
    """

    ablations: Positional[
        Annotated[Path, arg(metavar="FILE", help="Set of ablations (TOML); its head says what it costs.")]
    ]
    out: Out
    surfaces: Annotated[
        Path | None,
        arg(metavar="DIR", help="Labels by `sfsnet-dr photometric-stereo`, to measure on too."),
    ] = None
    photographs: Annotated[
        Path | None,
        arg(metavar="DIR", help="Photographs with landmarks, for the variants that learn from some."),
    ] = None
    environments: Annotated[
        Path | None,
        arg(metavar="DIR", help="Environment maps (.exr, .hdr) to light by, in place of the recipe's."),
    ] = None
    model_path: Annotated[
        Path | None, arg(metavar="PATH", help="Face model of the variants that need a file: ict's .npz.")
    ] = None
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.study.ablations import read_ablations
        from sfsnet_dr.study.ablations_run import run_ablations

        plan = read_ablations(
            self.ablations,
            self.out,
            photographs=self.photographs,
            surfaces=self.surfaces,
            environments=self.environments,
            model_path=self.model_path,
        )
        records = run_ablations(plan, command=command_line())
        lines = [f"left out: {name} {why}" for name, why in plan.left_out.items()]
        return of_records(records, *lines, f"page: {self.out / 'index.html'}")
