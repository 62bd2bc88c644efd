"""The commands that time the fast kernels against their twins."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from sfsnet_dr.commands.result import Json, Result, command_line

if TYPE_CHECKING:
    from sfsnet_dr.report.record import Record

Rounds = Annotated[int, arg(help="Turns that each contender has.")]
Compiled = Annotated[bool, arg(help="Whether to measure torch.compile too, which compiles for minutes.")]
RecordsFile = Annotated[Path | None, arg(metavar="FILE", help="Write the records to this file too.")]


@dataclass(frozen=True)
class BenchLoss:
    """Time the reconstruction loss with its gradients against torch, the memory and other kernels.

    Example: sfsnet-dr bench loss --records eval/results/loss.json
    """

    rounds: Rounds = 15
    compiled: Compiled = True
    variants: Annotated[bool, arg(help="Whether to measure other versions of the kernel too.")] = True
    records: RecordsFile = None
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.study.bench.loss import bench_loss

        _make_folder(self.records)
        options = {"compiled": self.compiled, "variants": self.variants}
        return _result(*bench_loss(command_line(), rounds=self.rounds, **options), self.records)


@dataclass(frozen=True)
class BenchRender:
    """Time the SH renderer against torch and the memory, and over the image size.

    Example: sfsnet-dr bench render --records eval/results/render.json
    """

    rounds: Rounds = 15
    compiled: Compiled = True
    records: RecordsFile = None
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.study.bench.render import bench_render

        _make_folder(self.records)
        return _result(
            *bench_render(command_line(), rounds=self.rounds, compiled=self.compiled), self.records
        )


def _make_folder(records: Path | None) -> None:
    """A folder that cannot be written is told before minutes of measuring, not after."""
    from sfsnet_dr.base.atomic import output_dir

    if records is not None:
        output_dir(records.parent)


@dataclass(frozen=True)
class BenchTrain:
    """Time the steps of a recipe against plain float32 steps, and what share data and loss have in them.

    Example: sfsnet-dr bench train training/recipes/smoke.toml --data out/faces --batch-size 8
    """

    recipe: Positional[Annotated[Path, arg(metavar="RECIPE", help="Recipe (TOML).")]]
    data: Annotated[Path, arg(metavar="DIR", help="Folder that `sfsnet-dr synth` wrote; few faces do.")]
    batch_size: Annotated[int | None, arg(help="Images a step, in place of the recipe's.")] = None
    rounds: Annotated[int, arg(help="Turns that each contender has.")] = 5
    records: RecordsFile = None
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.fit.recipe import read_recipe
        from sfsnet_dr.study.bench.train import bench_train

        recipe = read_recipe(self.recipe)
        recipe = replace(recipe, batch_size=self.batch_size or recipe.batch_size)
        return _result(*bench_train(recipe, self.data, command_line(), rounds=self.rounds), self.records)


def _result(records: list[Record], lines: list[str], path: Path | None) -> Result:
    from sfsnet_dr.report.record import to_json, write_records

    if path is not None:
        write_records(path, records)
    return Result(text="\n".join(lines), json=to_json(records))
