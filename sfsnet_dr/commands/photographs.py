"""Commands that make training data of photographs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from sfsnet_dr.commands.result import Json, Out, Result, command_line, of_records


@dataclass(frozen=True)
class PseudoLabel:
    """Label photographs of faces with a network's answers, to train another network on (labels, confidence).

    PHOTOS is a folder of JPEG or PNG files whose 68 landmarks a face are in landmarks.npz, or in
    PHOTOS_landmarks.npz beside it (files: N names, points: N x 68 x 2 pixels), or a folder of such folders.
    Photographs without a face are skipped and told in OUT/manifest.json, where those held back are named too.
    The same command goes on where it was stopped.

    Example: sfsnet-dr pseudo-label photos --weights out/skipnet/weights.safetensors --out out/labels
    """

    photographs: Positional[Annotated[Path, arg(metavar="PHOTOS", help="Folder of photographs.")]]
    weights: Annotated[Path, arg(metavar="FILE", help="Weights of `sfsnet-dr train`, or a shipped name.")]
    out: Out
    size: Annotated[
        int | None, arg(help="Width of the labels in pixels; left out, that of the weights' training.")
    ] = None
    held_back: Annotated[int, arg(help="Photographs that get no labels, to measure on.")] = 500
    most: Annotated[int | None, arg(help="Label no more than these many.")] = None
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.data.photo_source import photo_folder
        from sfsnet_dr.fit.pseudo_label import pseudo_label
        from sfsnet_dr.report.console import bar
        from sfsnet_dr.report.record import measured

        source = photo_folder(self.photographs, held_back=self.held_back, most=self.most)
        with bar("labelling photographs", len(source.train)) as advance:

            def on_shard(count: int) -> None:
                for _ in range(count):
                    advance()

            told = pseudo_label(source, self.weights, self.out, size=self.size, on_shard=on_shard)
        numbers = {
            "labelled": told["labelled"],
            "skipped": len(told["skipped"]),
            "held_back": len(told["held_back"]),
        }
        records = [
            measured(f"pseudo_label.{name}", count, "photographs", command=command_line())
            for name, count in numbers.items()
        ]
        skipped = [f"skipped: {name}: {reason}" for name, reason in list(told["skipped"].items())[:20]]
        return of_records(records, *skipped, f"written: {self.out}")
