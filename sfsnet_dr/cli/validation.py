"""Commands that compare renderers: validate, worst-light, regress and stability."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

from sfsnet_dr.cli.common import Json, Out, Result, command_line, result_of_records


@dataclass(frozen=True)
class Validate:
    """Measure shading models and renderers against the path tracer: error, cause and time on one scene.

    Ends in one sentence: the cheapest model within the tolerance under every light, its error and its speed.
    OUT gets a page (index.html), every number (records.json, errors.csv), the plot of error against time and
    maps of the errors.

    Example: sfsnet-dr validate --scene head --lights standard --tolerance 0.05 --out out/validate
    """

    out: Out
    scene: Annotated[
        str,
        arg(
            metavar="NAME|FILE",
            help="sphere, plane, bowl, two_spheres, relief, head, smile, head_ict, glossy_head, dark_skin, "
            "light_skin, a file (.toml), or all of the named ones.",
        ),
    ] = "head"
    lights: Annotated[
        str,
        arg(
            metavar="SET",
            help="standard, all, constant, bands, natural, environments, directional, sun_sky, two_colours, "
            "or single lights such as directional60; several with commas.",
        ),
    ] = "standard"
    tolerance: Annotated[float, arg(metavar="RATIO", help="Relative RMS error that is allowed.")] = 0.05
    renderers: Annotated[
        str,
        arg(metavar="NAMES", help="Registered renderers to compare too: all, none, or names with commas."),
    ] = "all"
    samples: Annotated[
        int | None, arg(metavar="N", help="Paths per pixel of each reference; the scene says if left out.")
    ] = None
    size: Annotated[
        int | None, arg(metavar="PIXELS", help="Edge of the image; the scene says if left out.")
    ] = None
    environments: Annotated[
        Path | None,
        arg(metavar="DIR", help="Environment maps (.exr, .hdr) that join the sets environments and all."),
    ] = None
    model_path: Annotated[
        Path | None, arg(metavar="PATH", help="The face model of scenes like head_ict, which come without.")
    ] = None
    seed: Annotated[int, arg(help="Seed of the head and of all noise.")] = 0
    as_json: Json = False

    def run(self) -> Result:
        from rich.console import Console

        from sfsnet_dr.experiments.validation.run import Request, validate, validate_all

        request = Request(
            scene=self.scene,
            lights=self.lights,
            tolerance=self.tolerance,
            renderers=self.renderers,
            samples=self.samples,
            size=self.size,
            seed=self.seed,
            environments=self.environments,
            model_path=self.model_path,
            command=command_line(),
        )
        if self.scene == "all":
            records = validate_all(request, self.out, Console(stderr=True).print)
            return result_of_records(records, f"reports: {self.out / 'SCENE' / 'index.html'}")
        records, sentence = validate(request, self.out)
        brief = [record for record in records if record.what.endswith(".rel_rmse")]
        shown = result_of_records(brief, f"report: {self.out / 'index.html'}", sentence)
        return Result(text=shown.text, json=result_of_records(records).json)


@dataclass(frozen=True)
class WorstLight:
    """Find how wrong an SH renderer can be on a scene: under the worst light, and under usual ones.

    Example: sfsnet-dr worst-light --scene head --out out/worst
    """

    scene: Annotated[str, arg(metavar="NAME|FILE.toml", help="A validation scene by name, or a scene file.")]
    out: Out
    order: Annotated[Literal[0, 1, 2, 4], arg(help="Order of the model whose worst lights are shown.")] = 2
    size: Annotated[int, arg(help="Width and height of the images in pixels.")] = 64
    samples: Annotated[int, arg(help="Camera rays a pixel of the captures.")] = 64
    lights: Annotated[int, arg(help="Lights drawn from the prior.")] = 400
    level: Annotated[int, arg(help="Division of the sphere of directions: 3 is 642, 4 is 2,562.")] = 3
    seed: Annotated[int, arg(help="Seed of the head, of the lights and of all noise.")] = 0
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.experiments.worst_light.page import worst_light
        from sfsnet_dr.experiments.worst_light.responses import Effort

        effort = Effort(size=self.size, samples=self.samples, level=self.level)
        records = worst_light(
            self.scene,
            self.out,
            effort,
            order=self.order,
            lights=self.lights,
            seed=self.seed,
            command=command_line(),
        )
        return result_of_records(records, f"report: {self.out / 'index.html'}")


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
        from sfsnet_dr.experiments.regression.config import CONFIG, REFERENCES
        from sfsnet_dr.experiments.regression.run import Options, regress
        from sfsnet_dr.report.record import to_json

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
        from sfsnet_dr.experiments.stability.run import run_stability

        study, records = run_stability(self.out, self.only, command=command_line())
        failures = study.failures()
        lines = [f"FAILED {line}" for line in failures]
        result = result_of_records(records, *lines, f"report: {self.out / 'index.html'}")
        return replace(result, code=1 if failures else 0)
