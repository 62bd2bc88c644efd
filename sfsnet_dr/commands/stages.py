"""The command that runs all stages of training."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from sfsnet_dr.commands.result import FaceFolders, Json, Out, Result, command_line, of_records


@dataclass(frozen=True)
class Stages:
    """Run every stage of SfS-supervision and measure the networks: OUT/index.html shows all of them.

    Renders faces into OUT/faces unless --data is given, trains SkipNet on them, labels the photographs with
    its answers, and trains SfSNet and SkipNet+ on both and SfSNet on rendered faces alone. The same command
    goes on where it was stopped; a stage that is done is not run again. Photographs come as `sfsnet-dr
    pseudo-label` takes them.

    Example: sfsnet-dr stages training/small.toml --photographs photos --out out/train
    """

    stages: Positional[
        Annotated[Path, arg(metavar="FILE", help="Set of stages (TOML); its head says what it costs.")]
    ]
    out: Out
    data: FaceFolders = ()
    photographs: Annotated[Path | None, arg(metavar="DIR", help="Folder of photographs with landmarks.")] = (
        None
    )
    rendered_photographs: Annotated[
        bool, arg(help="Let rendered faces stand in for photographs, to see the stages run.")
    ] = False
    environments: Annotated[
        Path | None,
        arg(metavar="DIR", help="Environment maps (.exr, .hdr) to light by, in place of the recipes'."),
    ] = None
    surfaces: Annotated[
        Path | None,
        arg(metavar="DIR", help="Labels by `sfsnet-dr photometric-stereo`, to fine-tune SfSNet on at last."),
    ] = None
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.study.stages import read_plan, run_stages

        plan = read_plan(
            self.stages,
            self.out,
            data=self.data,
            photographs=self.photographs,
            rendered_photographs=self.rendered_photographs,
            environments=self.environments,
            surfaces=self.surfaces,
        )
        return of_records(run_stages(plan, command=command_line()), f"page: {self.out / 'index.html'}")
