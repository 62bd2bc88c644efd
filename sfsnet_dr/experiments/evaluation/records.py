"""Errors of many photographs as records and as tables."""

from __future__ import annotations

import csv
import io
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.experiments.evaluation.measure import REGIONS, ImageErrors, MethodErrors
from sfsnet_dr.experiments.evaluation.samples import Collection
from sfsnet_dr.metrics.bootstrap import bootstrap_interval
from sfsnet_dr.metrics.light import class_ranks
from sfsnet_dr.report.html import Table
from sfsnet_dr.report.record import Record, dotted_word, make_record

Array = npt.NDArray[np.float64]

#: Angles (degrees) of the light from the viewer's direction at which bins begin and end.
BINS: Final = ((0, 12), (12, 25), (25, 50), (50, 77), (77, 181))

#: Means over photographs: the record's name, the errors' field, the unit.
_MEANS: Final = (
    ("albedo.scaled_rms", "albedo", "1"),
    ("albedo.confident.scaled_rms", "albedo_confident", "1"),
    ("recon.mae", "mae", "8-bit sRGB"),
    ("recon.rmse", "rmse", "8-bit sRGB"),
    ("recon.delta_e", "delta_e", "Delta E 2000"),
    ("lights.scaled_rms", "light", "1"),
    ("lights.direction_deg", "light_deg", "degrees"),
)


def bin_name(low: int, high: int) -> str:
    """How a bin of the light's angle is called in records."""
    return f"angle{low}_{min(high, 180)}"


def region_name(region: str) -> str:
    """How a region of the face is called in records."""
    return f"region_{dotted_word(region)}"


def normal_statistics(images: Sequence[ImageErrors]) -> dict[str, float]:
    """Mean, standard deviation (degrees) and shares (percent) over all pixels of all photographs."""
    return _statistics(np.sum([e.normals.all for e in images if e.normals is not None], axis=0))


def _statistics(sums: Array) -> dict[str, float]:
    pixels, total, squares, *below = sums
    mean = total / pixels
    shares = {f"below{limit}": 100 * count / pixels for limit, count in zip((20, 25, 30), below, strict=True)}
    return {"mean_deg": mean, "std_deg": float(np.sqrt(max(squares / pixels - mean**2, 0))), **shares}


def sample_counts(collection: Collection, command: str) -> list[Record]:
    """``<data>.{images,subjects,skipped}``: what was measured, and what could not be."""
    head = dotted_word(collection.data)
    numbers = {
        "images": (len(collection.shots), "photographs"),
        "subjects": (len(collection.subjects), "people"),
        "skipped": (len(collection.skipped), "files or captures"),
    }
    return [
        make_record(f"{head}.{name}", value, unit, command=command) for name, (value, unit) in numbers.items()
    ]


def evaluation_records(collection: Collection, found: MethodErrors, command: str) -> list[Record]:
    """``<data>.<method>.{normals,albedo,recon,lights,lights64,images_per_s}``, as far as they are known."""
    head = f"{dotted_word(collection.data)}.{dotted_word(found.method)}"

    def one(name: str, value: float, unit: str, ends: tuple[float, float] | None = None) -> Record:
        return make_record(f"{head}.{name}", value, unit, command=command, interval=ends)

    records = _normals(one, found.images)
    for name, field, unit in _MEANS:
        images = [e for e in found.images if getattr(e, field) is not None]
        if images:
            values = [getattr(e, field) for e in images]
            records.append(one(name, float(np.mean(values)), unit, _ends(images, values)))
    few = [e for e in found.images if e.shot.light in collection.few]
    if len({e.shot.light for e in light_classification(few)[0]}) == len(collection.few):
        records += _classes(one, "lights", few)
    records += _classes(one, "lights64", [e for e in found.images if e.shot.light])
    return [*records, one("images_per_s", found.images_per_s, "images/s")]


_One = Callable[..., Record]


def _normals(one: _One, every: Sequence[ImageErrors]) -> list[Record]:
    images = [e for e in every if e.normals is not None]
    if not images:
        return []
    sums = by_subject(images, np.array([e.normals.all for e in images if e.normals is not None]))
    found = []
    for key, value in _statistics(sums.sum(0)).items():
        ends = None
        if len(sums) > 1:

            def statistic(drawn: Array, key: str = key) -> float:
                return _statistics(drawn.sum(0))[key]

            ends = tuple(bootstrap_interval(sums, statistic))
        found.append(one(f"normals.{key}", value, "degrees" if key.endswith("deg") else "%", ends))
    for low, high in BINS:
        part = [e for e in images if (angle := angle_of(e)) is not None and low <= angle < high]
        if part:
            numbers, name = normal_statistics(part), f"normals.{bin_name(low, high)}"
            found.append(one(f"{name}.mean_deg", numbers["mean_deg"], "degrees"))
            found.append(one(f"{name}.below20", numbers["below20"], "%"))
    regions = np.sum([e.normals.regions for e in images if e.normals is not None], axis=0)
    for region, (pixels, total) in zip(REGIONS, regions, strict=True):
        if pixels:
            found.append(one(f"normals.{region_name(region)}.mean_deg", total / pixels, "degrees"))
    return found


def angle_of(errors: ImageErrors) -> float | None:
    """Angle of a photograph's only light from the viewer's direction, degrees."""
    direction = errors.shot.direction
    return None if direction is None else float(np.degrees(np.arccos(np.clip(direction[2], -1, 1))))


def light_classification(images: Sequence[ImageErrors]) -> tuple[list[ImageErrors], list[str]]:
    """The photographs that can be classified, and the lights that cannot: seen with one subject only."""
    who = defaultdict(set)
    for e in images:
        who[e.shot.light].add(e.shot.subject)
    alone = sorted(light for light, subjects in who.items() if len(subjects) < 2)
    return [e for e in images if e.shot.light not in alone], alone


def _classes(one: _One, name: str, every: Sequence[ImageErrors]) -> list[Record]:
    images, _ = light_classification(every)
    if len({e.shot.light for e in images}) < 2:
        return []
    ranks = class_ranks(
        [e.coefficients for e in images], [e.shot.light for e in images], [e.shot.subject for e in images]
    )
    found = [one(f"{name}.classes", len({e.shot.light for e in images}), "lights")]
    for top in (1, 2, 3):
        hits = 100.0 * (ranks <= top)
        found.append(one(f"{name}.top{top}", float(hits.mean()), "%", _ends(images, hits)))
    return found


def _ends(images: Sequence[ImageErrors], values: npt.ArrayLike) -> tuple[float, float] | None:
    """Interval of the mean over photographs by drawing subjects."""
    numbers = np.asarray(values, np.float64)
    sums = by_subject(images, np.stack([numbers, np.ones_like(numbers)], 1))
    if len(sums) < 2:
        return None
    low, high = bootstrap_interval(sums, lambda drawn: float(drawn[:, 0].sum() / drawn[:, 1].sum()))
    return low, high


def by_subject(images: Sequence[ImageErrors], rows: Array) -> Array:
    """Sums of rows (N, K) over the photographs of each subject."""
    _, places = np.unique([e.shot.subject for e in images], return_inverse=True)
    total = np.zeros((places.max() + 1, rows.shape[1]))
    np.add.at(total, places, rows)
    return total


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
            ("albedo.confident.scaled_rms", "high-confidence pixels", 3),
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


def result_tables(data: str, names: Sequence[str], records: Sequence[Record]) -> list[Table]:
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
    heads = [f"{dotted_word(data)}.{dotted_word(name)}." for name in names]
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
    return f"{dotted_word(data)}.{dotted_word(name)}.{what}"


def _cell(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
