"""Commands that measure how fast and how right the factory of faces is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from sfsnet_dr.commands.result import Json, Out, Result, command_line, of_records

if TYPE_CHECKING:
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
        from sfsnet_dr.report.console import bar
        from sfsnet_dr.study.bench_synth import STEPS, bench_synth
        from sfsnet_dr.study.bench_synth_page import write_bench

        with bar("measuring", STEPS) as advance:
            records = bench_synth(
                _spec(self.scene), faces=self.faces, seed=self.seed, command=command_line(), on_step=advance
            )
        write_bench(self.out, records)
        return of_records(records, f"page: {self.out / 'index.html'}")


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
        from sfsnet_dr.report.console import bar
        from sfsnet_dr.study.relight_study import bench_relight

        spec = _spec(self.scene)
        if self.environments is not None:
            spec = replace(spec, light=replace(spec.light, environments=str(self.environments)))
        spec = replace(spec, sampling=replace(spec.sampling, reference=self.paths))
        with bar("measuring faces", self.faces) as advance:
            records = bench_relight(
                spec, self.out, faces=self.faces, seed=self.seed, command=command_line(), on_face=advance
            )
        return of_records(records, f"page: {self.out / 'index.html'}")


def _spec(scene: Path | None) -> SceneSpec:
    from sfsnet_dr.scene.spec import SceneSpec, load_scene

    return SceneSpec("faces", "anny") if scene is None else load_scene(scene)
