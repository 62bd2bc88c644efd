"""Errors of many photographs as records: over all, by the light's angle and the face's regions."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.metrics.bootstrap import interval
from sfsnet_dr.metrics.light_classes import class_ranks
from sfsnet_dr.report.record import Record, dotted, measured
from sfsnet_dr.study.evaluate.measure import ImageErrors, Measured
from sfsnet_dr.study.evaluate.regions import REGIONS
from sfsnet_dr.study.evaluate.shots import Collection

Array = npt.NDArray[np.float64]

#: Angles (degrees) of the light from the viewer's direction at which bins begin and end.
BINS: Final = ((0, 12), (12, 25), (25, 50), (50, 77), (77, 181))

#: Means over photographs: the record's name, the errors' field, the unit.
_MEANS: Final = (
    ("albedo.scaled_rms", "albedo", "1"),
    ("albedo.sure.scaled_rms", "albedo_sure", "1"),
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
    return f"region_{dotted(region)}"


def normal_statistics(images: Sequence[ImageErrors]) -> dict[str, float]:
    """Mean, standard deviation (degrees) and shares (percent) over all pixels of all photographs."""
    return _statistics(np.sum([e.normals.all for e in images if e.normals is not None], axis=0))


def _statistics(sums: Array) -> dict[str, float]:
    pixels, total, squares, *below = sums
    mean = total / pixels
    shares = {f"below{limit}": 100 * count / pixels for limit, count in zip((20, 25, 30), below, strict=True)}
    return {"mean_deg": mean, "std_deg": float(np.sqrt(max(squares / pixels - mean**2, 0))), **shares}


def counts_of(collection: Collection, command: str) -> list[Record]:
    """``<data>.{images,subjects,skipped}``: what was measured, and what could not be."""
    head = dotted(collection.data)
    numbers = {
        "images": (len(collection.shots), "photographs"),
        "subjects": (len(collection.subjects), "people"),
        "skipped": (len(collection.skipped), "files or captures"),
    }
    return [
        measured(f"{head}.{name}", value, unit, command=command) for name, (value, unit) in numbers.items()
    ]


def records_of(collection: Collection, found: Measured, command: str) -> list[Record]:
    """``<data>.<method>.{normals,albedo,recon,lights,lights64,images_per_s}``, as far as they are known."""
    head = f"{dotted(collection.data)}.{dotted(found.method)}"

    def one(name: str, value: float, unit: str, ends: tuple[float, float] | None = None) -> Record:
        return measured(f"{head}.{name}", value, unit, command=command, interval=ends)

    records = _normals(one, found.images)
    for name, field, unit in _MEANS:
        images = [e for e in found.images if getattr(e, field) is not None]
        if images:
            values = [getattr(e, field) for e in images]
            records.append(one(name, float(np.mean(values)), unit, _ends(images, values)))
    few = [e for e in found.images if e.shot.light in collection.few]
    if len({e.shot.light for e in classified(few)[0]}) == len(collection.few):
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

            ends = tuple(interval(sums, statistic))
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


def classified(images: Sequence[ImageErrors]) -> tuple[list[ImageErrors], list[str]]:
    """The photographs that can be classified, and the lights that cannot: seen with one subject only."""
    who = defaultdict(set)
    for e in images:
        who[e.shot.light].add(e.shot.subject)
    alone = sorted(light for light, subjects in who.items() if len(subjects) < 2)
    return [e for e in images if e.shot.light not in alone], alone


def _classes(one: _One, name: str, every: Sequence[ImageErrors]) -> list[Record]:
    images, _ = classified(every)
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
    low, high = interval(sums, lambda drawn: float(drawn[:, 0].sum() / drawn[:, 1].sum()))
    return low, high


def by_subject(images: Sequence[ImageErrors], rows: Array) -> Array:
    """Sums of rows (N, K) over the photographs of each subject."""
    _, places = np.unique([e.shot.subject for e in images], return_inverse=True)
    total = np.zeros((places.max() + 1, rows.shape[1]))
    np.add.at(total, places, rows)
    return total
