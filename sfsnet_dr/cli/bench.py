"""Commands that measure speed: rendering, shading, loss, training and relighting."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from sfsnet_dr.cli.common import Json, Out, Result, command_line, result_of_records

if TYPE_CHECKING:
    from sfsnet_dr.report.record import Record
    from sfsnet_dr.scene.spec import SceneSpec

_Scene = Annotated[
    Path | None, arg(metavar="FILE", help="Scene (TOML); left out, that of scenes/faces.toml.")
]
_Seed = Annotated[int, arg(help="Seed of the first face.")]


@dataclass(frozen=True)
class BenchSynth:
    """Measure how fast faces are rendered: against one render for each light, and against bare rays.

    Writes records.json, noise.png and index.html. Takes some minutes, in which nothing else should run.

    Example: sfsnet-dr bench synth --out out/bench
    """

    out: Out
    scene: _Scene = None
    faces: Annotated[int, arg(help="Faces that bundles a second are measured on.")] = 6
    seed: _Seed = 0
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.experiments.benchmarks.generate import STEPS, bench_synth, write_bench
        from sfsnet_dr.report.console import progress_bar

        with progress_bar("measuring", STEPS) as advance:
            records = bench_synth(
                _spec(self.scene), faces=self.faces, seed=self.seed, command=command_line(), on_step=advance
            )
        write_bench(self.out, records)
        return result_of_records(records, f"page: {self.out / 'index.html'}")


@dataclass(frozen=True)
class BenchRelight:
    """Measure relit faces against path-traced ones: the error, and how much of it comes from what.

    Writes records.json and index.html. About a minute a face; a run that was cut off goes on where it was.

    Example: sfsnet-dr bench relight --out out/relight --faces 4
    """

    out: Out
    scene: _Scene = None
    environments: Annotated[
        Path | None, arg(metavar="DIR", help="Folder of environment maps (.exr, .hdr), for one more light.")
    ] = None
    faces: Annotated[int, arg(help="Faces, each under one light of every kind.")] = 20
    paths: Annotated[int, arg(help="Paths a pixel of each path-traced image, at least 2.")] = 64
    seed: _Seed = 0
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.experiments.benchmarks.relight import bench_relight
        from sfsnet_dr.report.console import progress_bar
        from sfsnet_dr.scene.lights.spec import LightSpec

        spec = _spec(self.scene)
        if self.environments is not None:
            light = replace(spec.light or LightSpec(), environments=str(self.environments))
            spec = replace(spec, light=light)
        spec = replace(spec, sampling=replace(spec.sampling, reference_spp=self.paths))
        with progress_bar("measuring faces", self.faces) as advance:
            records = bench_relight(
                spec, self.out, faces=self.faces, seed=self.seed, command=command_line(), on_face=advance
            )
        return result_of_records(records, f"page: {self.out / 'index.html'}")


def _spec(scene: Path | None) -> SceneSpec:
    from sfsnet_dr.scene.spec import SceneSpec, load_scene

    return SceneSpec("faces", "anny") if scene is None else load_scene(scene)


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
        from sfsnet_dr.experiments.benchmarks.loss import bench_loss

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
        from sfsnet_dr.experiments.benchmarks.shading import bench_render

        _make_folder(self.records)
        return _result(
            *bench_render(command_line(), rounds=self.rounds, compiled=self.compiled), self.records
        )


def _make_folder(records: Path | None) -> None:
    """A folder that cannot be written is told before minutes of measuring, not after."""
    from sfsnet_dr.core.files import output_dir

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
        from sfsnet_dr.experiments.benchmarks.train import bench_train
        from sfsnet_dr.train.config import read_recipe

        recipe = read_recipe(self.recipe)
        recipe = replace(recipe, batch_size=self.batch_size or recipe.batch_size)
        return _result(*bench_train(recipe, self.data, command_line(), rounds=self.rounds), self.records)


def _result(records: list[Record], lines: list[str], path: Path | None) -> Result:
    from sfsnet_dr.report.record import to_json, write_records

    if path is not None:
        write_records(path, records)
    return Result(text="\n".join(lines), json=to_json(records))
