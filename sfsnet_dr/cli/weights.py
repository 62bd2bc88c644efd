"""Commands on weights files, and the one that fits a prior over light."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from sfsnet_dr.cli.common import Json, Out, Result, command_line, result_of_records


@dataclass(frozen=True)
class WeightsList:
    """Name the networks that come with the package, with the numbers of their cards.

    Wherever a command takes --weights, one of these names will do.

    Example: sfsnet-dr weights list
    """

    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.experiments.pipeline.model_card import card_records
        from sfsnet_dr.models.shipped import FOLDER, HELDOUT, SHIPPED

        records = [record for name in SHIPPED for record in card_records(name)]
        return result_of_records(
            records,
            f"cards: {FOLDER}/NAME.md for {', '.join((*SHIPPED, *HELDOUT))}",
        )


@dataclass(frozen=True)
class WeightsCheck:
    """Measure shipped networks and hold the numbers to those of their cards; exit code 1 where they differ.

    Two dozen unseen faces are rendered into OUT first (a minute); photographs are measured too where a folder
    of them is given, as `sfsnet-dr pseudo-label` takes it.

    Example: sfsnet-dr weights check --out out/check
    """

    out: Out
    names: Annotated[
        tuple[Path, ...], arg(metavar="NAME", help="Shipped names or files; left out, all shipped.")
    ] = ()
    photographs: Annotated[Path | None, arg(metavar="DIR", help="Folder of photographs with landmarks.")] = (
        None
    )
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.experiments.pipeline.model_card import (
            FACES,
            card_records,
            compare_with_card,
            measure_shipped,
        )
        from sfsnet_dr.models.shipped import SHIPPED
        from sfsnet_dr.report.console import progress_bar
        from sfsnet_dr.report.record import to_json, write_records

        names = self.names or tuple(Path(name) for name in SHIPPED)
        with progress_bar("rendering faces", FACES) as advance:
            records = measure_shipped(
                names, self.out, command_line(), photographs=self.photographs, on_face=lambda _: advance()
            )
        write_records(self.out / "records.json", records)
        card = [record for name in names if str(name) in SHIPPED for record in card_records(str(name))]
        compared = compare_with_card(records, card)
        return Result(
            text="\n".join(map(str, compared)),
            json=to_json(records),
            code=0 if all(one.same for one in compared) else 1,
        )


@dataclass(frozen=True)
class WeightsQuantize:
    """Quantize the large tensors of a weights file to eight bits: a quarter of the size.

    Folders named in the metadata are reduced to their last part.

    Example: sfsnet-dr weights quantize out/sfsnet/weights.safetensors --out sfsnet.safetensors
    """

    weights: Positional[Annotated[Path, arg(metavar="FILE", help="Weights that `sfsnet-dr train` wrote.")]]
    out: Annotated[Path, arg(metavar="FILE", help="File to write.")]
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.models.weights import load_weights, read_metadata, save_weights
        from sfsnet_dr.report.record import make_record

        metadata = read_metadata(self.weights)
        light = metadata.get("recipe", {}).get("data", {}).get("light", {})
        for key in ("environments", "mixture"):
            if light.get(key):
                light[key] = Path(light[key]).name
        save_weights(self.out, load_weights(self.weights), metadata, eight_bit=True)
        size = make_record("weights.bytes", self.out.stat().st_size, "B", command=command_line())
        return result_of_records([size], f"written: {self.out}")


@dataclass(frozen=True)
class WeightsAverage:
    """Average checkpoints of one network; the average is often better than each of them.

    The metadata of the last file is kept, with the checksum and coefficient of every file.

    Example: sfsnet-dr weights average a.safetensors b.safetensors --coefficients 3 7 --out mean.safetensors
    """

    weights: Positional[
        Annotated[tuple[Path, ...], arg(metavar="FILE", help="Weights of one kind of network.")]
    ]
    out: Annotated[Path, arg(metavar="FILE", help="File to write.")]
    coefficients: Annotated[
        tuple[float, ...], arg(metavar="C", help="Weight of each file, any scale. Default: equal.")
    ] = ()
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.core.provenance import sha256
        from sfsnet_dr.models.shipped import weights_path
        from sfsnet_dr.models.weights import read_metadata, save_weights
        from sfsnet_dr.report.record import make_record
        from sfsnet_dr.train.averaging import average_weights

        model = average_weights(self.weights, self.coefficients)
        shares = self.coefficients or (1.0,) * len(self.weights)
        parts = [
            {"sha256": sha256(weights_path(path)), "share": share}
            for path, share in zip(self.weights, shares, strict=True)
        ]
        save_weights(self.out, model, read_metadata(self.weights[-1]) | {"mean_of": parts})
        size = make_record("weights.bytes", self.out.stat().st_size, "B", command=command_line())
        return result_of_records([size], f"written: {self.out}")


@dataclass(frozen=True)
class FitLightPrior:
    """Fit a prior over light: a Gaussian mixture over the lights of photographs.

    PHOTOS is a folder as `sfsnet-dr pseudo-label` takes it. Writes OUT/fits.jsonl, a line a photograph,
    OUT/mixture.json, and OUT/overlays.png to look at. A recipe draws lights from the mixture with
    data.light.fitted above 0, and data.light.light_prior_file for another one than the package's own. The
    same command goes on where it was stopped.

    Example: sfsnet-dr fit-light-prior photos --model-path FaceXModel --out out/lights
    """

    photographs: Positional[Annotated[Path, arg(metavar="PHOTOS", help="Folder of photographs.")]]
    model_path: Annotated[
        Path, arg(metavar="PATH", help="ICT FaceKit: its compact .npz, a clone, or its FaceXModel folder.")
    ]
    out: Out
    max_images: Annotated[int | None, arg(help="Fit at most this many photographs, chosen by the seed.")] = (
        None
    )
    components: Annotated[
        int | None,
        arg(help="Number of mixture components. Default: the best of 1 to 12 by held-out log-likelihood."),
    ] = None
    draws: Annotated[int, arg(help="Lights drawn to see how many are impossible.")] = 20000
    seed: Annotated[int, arg(help="Of the choice of photographs and of the mixture's start.")] = 0
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.data.photos import list_photos
        from sfsnet_dr.experiments.light_prior import FitLightsOptions, fit_lights
        from sfsnet_dr.report.console import progress_bar
        from sfsnet_dr.report.record import make_record
        from sfsnet_dr.scene.faces.linear_model import load_face_modes

        options = FitLightsOptions(self.max_images, self.components, self.draws, self.seed)
        total = len(list_photos(self.photographs)[0])
        model = load_face_modes(self.model_path)
        with progress_bar("fitting photographs", min(total, self.max_images or total)) as advance:
            told = fit_lights(self.photographs, model, self.out, options, on_photo=advance)
        records = [
            make_record(f"fit_lights.{name}", value, unit, command=command_line(), seed=self.seed)
            for name, (value, unit) in told.numbers.items()
        ]
        skipped = [f"skipped: {name}: {reason}" for name, reason in list(told.skipped.items())[:20]]
        return result_of_records(records, *skipped, f"written: {self.out}")
