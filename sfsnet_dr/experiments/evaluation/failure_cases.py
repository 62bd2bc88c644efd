"""The best and the worst photographs of a method, and what sets the worst apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.stats import spearmanr

from sfsnet_dr.experiments.evaluation.measure import ImageErrors
from sfsnet_dr.experiments.evaluation.samples import EvaluationSample, spread_out

Array = npt.NDArray[np.float64]

#: The share of photographs that counts as best or worst, as in the paper.
SHARE: Final = 0.05
#: A cause stands out if its distance from the mean of all photographs, in standard deviations, times its rank
#: correlation with the error is above this.
_STANDS_OUT: Final = 0.3


@dataclass(frozen=True)
class FailureCause:
    """Means of one possible cause over the best, all and the worst photographs.

    ``spread`` is its standard deviation over all, ``rank`` its rank correlation with the error over all of
    them, NaN where it never varies.
    """

    name: str
    best: float
    all: float
    worst: float
    spread: float
    rank: float


@dataclass(frozen=True, eq=False)
class Extremes:
    """Attributes:

    best, worst: errors of 5 % of the photographs each, at least one, the most extreme first.
    causes: of these photographs.
    unit: of ``failure_score``.
    """

    best: list[ImageErrors]
    worst: list[ImageErrors]
    causes: list[FailureCause]
    unit: str


def failure_score(errors: ImageErrors) -> float | None:
    """The error that photographs are ranked by: of normals where they are known, else of reconstruction."""
    return errors.rmse if errors.normals is None else errors.normals.mean


def find_extremes(images: Sequence[ImageErrors]) -> Extremes | None:
    """Rank the photographs of one method; None if it has fewer than three with a score."""
    ranked = sorted(
        (e for e in images if failure_score(e) is not None), key=lambda e: failure_score(e) or 0.0
    )
    if len(ranked) < 3:
        return None
    count = max(1, round(SHARE * len(ranked)))
    scores = np.array([failure_score(e) for e in ranked])
    names = [n for n in ranked[0].shot.causes if all(n in e.shot.causes for e in ranked)]
    causes = []
    for name in names:
        values = np.array([e.shot.causes[name] for e in ranked])
        varies = np.ptp(values) > 0 and np.ptp(scores) > 0
        rank = float(spearmanr(values, scores).statistic) if varies else float("nan")
        best, middle, worst = (float(part.mean()) for part in (values[:count], values, values[-count:]))
        causes.append(FailureCause(name, best, middle, worst, float(values.std()), rank))
    unit = "8-bit" if ranked[0].normals is None else "deg"
    return Extremes(ranked[:count], ranked[::-1][:count], causes, unit)


def example_rows(images: Sequence[ImageErrors], most: int) -> list[ImageErrors]:
    """Some of them, spread evenly, with as many different subjects as there are."""
    first: dict[str, ImageErrors] = {}
    for e in images:
        first.setdefault(e.shot.subject, e)
    fresh = list(first.values())
    rest = [e for e in images if not any(e is other for other in fresh)]
    chosen = [fresh[place] for place in spread_out(len(fresh), most)]
    return chosen + rest[: most - len(chosen)]


def describe_failure(shot: EvaluationSample, causes: Sequence[FailureCause]) -> str:
    """The cause that tells most of a photograph's error, with its value; or that none does.

    It is the one furthest from its mean in the direction in which errors grow, weighted with their rank
    correlation.
    """
    best, text = _STANDS_OUT, "nothing stands out"
    for cause in causes:
        away = (shot.causes[cause.name] - cause.all) / cause.spread if cause.spread > 0 else 0.0
        says = away * float(np.nan_to_num(cause.rank))
        if says > best:
            best, text = says, write_extremes(cause.name, shot.causes[cause.name], few=away < 0)
    return text


def write_extremes(name: str, value: float, few: bool = False) -> str:
    """A cause with its value and unit: ``cast shadow 31 %``, ``light only 5 deg``."""
    unit = "deg" if name.endswith("(deg)") else "%"
    return f"{name.removesuffix(' (deg)')} {'only ' if few else ''}{value:.0f} {unit}"
