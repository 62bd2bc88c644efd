"""The command that looks for the light under which the model is most wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from tyro.conf import arg

from sfsnet_dr.commands.result import Json, Out, Result, command_line, of_records


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
        from sfsnet_dr.study.light_answers import Effort
        from sfsnet_dr.study.worst_light_report import worst_light

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
        return of_records(records, f"report: {self.out / 'index.html'}")
