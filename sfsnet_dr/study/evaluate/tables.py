"""Records of an evaluation as tables: small ones for a page, one wide one for other programs."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from sfsnet_dr.report.html import Table
from sfsnet_dr.report.record import Record, dotted
from sfsnet_dr.study.evaluate.regions import REGIONS
from sfsnet_dr.study.evaluate.summary import BINS, bin_name, region_name

#: A column: what its record is called after the method, its heading, its digits.
Column = tuple[str, str, int]

_SPEED: Final[Column] = ("images_per_s", "images/s", 1)


@dataclass(frozen=True)
class Layout:
    """One table: its columns, and what a reader must know."""

    columns: tuple[Column, ...]
    caption: str


LAYOUTS: Final = (
    Layout(
        (
            ("normals.mean_deg", "normals (deg)", 1),
            ("normals.std_deg", "std", 1),
            ("normals.below20", "below 20 (%)", 1),
            ("normals.below25", "below 25", 1),
            ("normals.below30", "below 30", 1),
            _SPEED,
        ),
        "Normals: angle to the true ones over the pixels of the faces; mean, standard deviation, and the "
        "share of pixels below 20, 25 and 30 degrees.",
    ),
    Layout(
        tuple(
            (f"normals.{bin_name(low, high)}.mean_deg", f"{low} to {min(high, 180)}", 1) for low, high in BINS
        ),
        "Normals by the light: mean error (degrees) of photographs whose light is this many degrees away "
        "from the viewer's direction.",
    ),
    Layout(
        tuple((f"normals.{region_name(name)}.mean_deg", name, 1) for name in REGIONS),
        "Normals by the region of the face: mean error (degrees). The outline is the outer 4 % of the frame.",
    ),
    Layout(
        (
            ("albedo.scaled_rms", "albedo", 3),
            ("albedo.sure.scaled_rms", "where truth is sure", 3),
            ("recon.mae", "MAE", 2),
            ("recon.rmse", "RMSE", 2),
            ("recon.delta_e", "Delta E 2000", 2),
            _SPEED,
        ),
        "Albedo: RMS error relative to the true RMS, after the best factor, on all of the face and where the "
        "truth's confidence is .9 and more. Reconstruction: mean absolute "
        "and RMS difference from the photograph in 8-bit sRGB units, each the mean over photographs; Delta E "
        "2000 for colour. A dash: the method's albedo is the photograph divided by the shading, so that it "
        "reconstructs anything without error whatever its normals are, and the number would tell nothing.",
    ),
    Layout(
        (
            ("lights.top1", "19 lights: top 1 (%)", 1),
            ("lights.top2", "top 2", 1),
            ("lights.top3", "top 3", 1),
            ("lights64.top1", "all lights: top 1 (%)", 1),
            ("lights64.top2", "top 2", 1),
            ("lights64.top3", "top 3", 1),
            ("lights.direction_deg", "direction (deg)", 1),
            ("lights.scaled_rms", "coefficients", 3),
            _SPEED,
        ),
        "Light: how often the true one is the nearest class mean of unit-length coefficients, or among the "
        "nearest two or three, each subject left out of the means; angle to the true direction; RMS error of "
        "the 27 coefficients relative to their RMS, after the best factor.",
    ),
)


def tables(data: str, names: Sequence[str], records: Sequence[Record]) -> list[Table]:
    """Every table that has numbers, with the columns that do; a dash where a method has none."""
    values = {record.what: record.value for record in records}
    found = []
    for layout in LAYOUTS:
        columns = [
            column for column in layout.columns if any(_key(data, n, column[0]) in values for n in names)
        ]
        if columns and columns != [_SPEED]:
            rows = [
                [name, *(_cell(values.get(_key(data, name, what)), digits) for what, _, digits in columns)]
                for name in names
            ]
            found.append(Table(["method", *(heading for _, heading, _ in columns)], rows, layout.caption))
    return found


def csv_text(data: str, names: Sequence[str], records: Sequence[Record]) -> str:
    """All numbers of all methods: a row a method, a column a record, empty where there is none."""
    values = {record.what: record.value for record in records}
    heads = [f"{dotted(data)}.{dotted(name)}." for name in names]
    columns = list(
        dict.fromkeys(what.removeprefix(h) for what in values for h in heads if what.startswith(h))
    )
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["method", *columns])
    for name, head in zip(names, heads, strict=True):
        cells = (values.get(head + column) for column in columns)
        writer.writerow([name, *("" if value is None else f"{value:.6g}" for value in cells)])
    return text.getvalue()


def _key(data: str, name: str, what: str) -> str:
    return f"{dotted(data)}.{dotted(name)}.{what}"


def _cell(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
