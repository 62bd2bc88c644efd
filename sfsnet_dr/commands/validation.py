"""The command that measures renderers on a scene."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from sfsnet_dr.commands.result import Json, Out, Result, command_line, of_records


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

        from sfsnet_dr.study.validate import Request, validate, validate_all

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
            return of_records(records, f"reports: {self.out / 'SCENE' / 'index.html'}")
        records, sentence = validate(request, self.out)
        brief = [record for record in records if record.what.endswith(".rel_rmse")]
        shown = of_records(brief, f"report: {self.out / 'index.html'}", sentence)
        return Result(text=shown.text, json=of_records(records).json)
