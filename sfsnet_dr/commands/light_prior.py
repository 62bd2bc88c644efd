"""The command that learns from photographs which lights there are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from sfsnet_dr.commands.result import Json, Out, Result, command_line, of_records


@dataclass(frozen=True)
class FitLights:
    """Fit a face model and its light to each photograph of a folder, and a mixture over all their lights.

    PHOTOS is a folder as `sfsnet-dr pseudo-label` takes it. Writes OUT/fits.jsonl, a line a photograph,
    OUT/mixture.json, and OUT/overlays.png to look at. A recipe draws lights from the mixture with
    data.light.fitted above 0, and data.light.mixture for another one than the package's own. The same command
    goes on where it was stopped.

    Example: sfsnet-dr fit-lights photos --model-path FaceXModel --out out/lights
    """

    photographs: Positional[Annotated[Path, arg(metavar="PHOTOS", help="Folder of photographs.")]]
    model_path: Annotated[
        Path, arg(metavar="PATH", help="ICT FaceKit: its compact .npz, a clone, or its FaceXModel folder.")
    ]
    out: Out
    most: Annotated[int | None, arg(help="Take no more than these many, drawn by the seed.")] = None
    components: Annotated[
        int | None, arg(help="Of the mixture; left out, 1 to 12: the number that foretells best.")
    ] = None
    draws: Annotated[int, arg(help="Lights drawn to see how many are impossible.")] = 20000
    seed: Annotated[int, arg(help="Of the choice of photographs and of the mixture's start.")] = 0
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.data.photo_set import list_photos
        from sfsnet_dr.report.console import bar
        from sfsnet_dr.report.record import measured
        from sfsnet_dr.scene.face_modes import load_face_modes
        from sfsnet_dr.study.fit_lights import FitLightsOptions, fit_lights

        options = FitLightsOptions(self.most, self.components, self.draws, self.seed)
        total = len(list_photos(self.photographs)[0])
        model = load_face_modes(self.model_path)
        with bar("fitting photographs", min(total, self.most or total)) as advance:
            told = fit_lights(self.photographs, model, self.out, options, on_photo=advance)
        records = [
            measured(f"fit_lights.{name}", value, unit, command=command_line(), seed=self.seed)
            for name, (value, unit) in told.numbers.items()
        ]
        skipped = [f"skipped: {name}: {reason}" for name, reason in list(told.skipped.items())[:20]]
        return of_records(records, *skipped, f"written: {self.out}")
