"""Errors of many images as records: over all lights, by their angle, with intervals over identities."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.metrics.bootstrap import interval
from sfsnet_dr.metrics.light_classes import class_ranks
from sfsnet_dr.report.record import Record, dotted, measured
from sfsnet_dr.study.evaluate.measure import ImageErrors, Measured

Array = npt.NDArray[np.float64]

#: Angles (degrees) of the light from the viewer's direction at which bins begin and end.
BINS: Final = ((0, 12), (12, 25), (25, 50), (50, 77), (77, 181))


def normal_statistics(images: Sequence[ImageErrors]) -> dict[str, float]:
    """Mean, standard deviation (degrees) and shares (percent) over all pixels of all images."""
    sums = np.array([[e.pixels, e.total, e.squares, *e.below] for e in images], np.float64).sum(0)
    return _statistics(sums)


def _statistics(sums: Array) -> dict[str, float]:
    pixels, total, squares, *below = sums
    mean = total / pixels
    shares = {f"below{limit}": 100 * count / pixels for limit, count in zip((20, 25, 30), below, strict=True)}
    return {"mean_deg": mean, "std_deg": float(np.sqrt(max(squares / pixels - mean**2, 0))), **shares}


def records_of(data: str, found: Measured, command: str, few: Sequence[str]) -> list[Record]:
    """``<data>.<method>.{normals,albedo,recon,lights,images_per_s}`` records.

    Args:
        data: name of the data.
        found: a method's errors.
        command: for the records.
        few: the lights of the 19-way classification, or none.
    """
    head = f"{dotted(data)}.{dotted(found.method)}"

    def one(name: str, value: float, unit: str, ends: tuple[float, float] | None = None) -> Record:
        return measured(f"{head}.{name}", value, unit, command=command, interval=ends)

    records = [*_normals(one, "normals", found.images)]
    for low, high in BINS:
        part = [e for e in found.images if low <= e.angle < high]
        if part:
            name = f"normals.angle{low}_{min(high, 180)}"
            records.append(one(f"{name}.mean_deg", normal_statistics(part)["mean_deg"], "degrees"))
            records.append(one(f"{name}.below20", normal_statistics(part)["below20"], "%"))
    plain = {
        "albedo.scaled_rms": ([e.albedo for e in found.images], "1"),
        "recon.mae": ([e.mae for e in found.images], "8-bit sRGB"),
        "recon.rmse": ([e.rmse for e in found.images], "8-bit sRGB"),
        "lights.direction_deg": ([e.light_deg for e in found.images], "degrees"),
    }
    for name, (values, unit) in plain.items():
        records.append(one(name, float(np.mean(values)), unit, _ends(found.images, values)))
    records += _classes(one, "lights", [e for e in found.images if e.light in few])
    records += _classes(one, "lights64", found.images)
    return [*records, one("images_per_s", found.images_per_s, "images/s")]


_One = Callable[..., Record]


def _normals(one: _One, name: str, images: Sequence[ImageErrors]) -> list[Record]:
    rows = {
        subject: np.array(
            [[e.pixels, e.total, e.squares, *e.below] for e in images if e.subject == subject]
        ).sum(0)
        for subject in sorted({e.subject for e in images})
    }
    by_subject = np.array(list(rows.values()), np.float64)
    found = []
    for key, value in _statistics(by_subject.sum(0)).items():
        ends = None
        if len(by_subject) > 1:

            def statistic(drawn: Array, key: str = key) -> float:
                return _statistics(drawn.sum(0))[key]

            ends = tuple(interval(by_subject, statistic))
        found.append(one(f"{name}.{key}", value, "degrees" if key.endswith("deg") else "%", ends))
    return found


def _classes(one: _One, name: str, images: Sequence[ImageErrors]) -> list[Record]:
    if len({e.subject for e in images}) < 2 or len({e.light for e in images}) < 2:
        return []
    try:
        ranks = class_ranks(
            [e.coefficients for e in images], [e.light for e in images], [e.subject for e in images]
        )
    except BadInput:
        return []  # a light that one subject only was seen under
    return [
        one(
            f"{name}.top{top}", 100 * float((ranks <= top).mean()), "%", _ends(images, 100.0 * (ranks <= top))
        )
        for top in (1, 2, 3)
    ]


def _ends(images: Sequence[ImageErrors], values: npt.ArrayLike) -> tuple[float, float] | None:
    """Interval of the mean over images by drawing subjects."""
    numbers = np.asarray(values, np.float64)
    subjects = np.array([e.subject for e in images])
    sums = np.array([[numbers[subjects == s].sum(), (subjects == s).sum()] for s in np.unique(subjects)])
    if len(sums) < 2:
        return None
    low, high = interval(sums, lambda drawn: float(drawn[:, 0].sum() / drawn[:, 1].sum()))
    return low, high
