"""The best and the worst photographs of a method, and what sets the worst apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.stats import spearmanr

from sfsnet_dr.study.evaluate.measure import ImageErrors
from sfsnet_dr.study.evaluate.shots import Shot, spread_out

Array = npt.NDArray[np.float64]

#: The share of photographs that counts as best or worst, as in the paper.
SHARE: Final = 0.05
#: A cause stands out if it is this many standard deviations above the mean of all photographs.
_STANDS_OUT: Final = 1.0


@dataclass(frozen=True)
class Cause:
    """Means of one possible cause over the best, all and the worst photographs.

    ``rank`` is its rank correlation with the error over all of them, NaN where it never varies.
    """

    name: str
    best: float
    all: float
    worst: float
    rank: float


@dataclass(frozen=True, eq=False)
class Extremes:
    """Attributes:

    best, worst: errors of 5 % of the photographs each, at least one, the most extreme first.
    causes: of these photographs.
    unit: of ``score``.
    """

    best: list[ImageErrors]
    worst: list[ImageErrors]
    causes: list[Cause]
    unit: str


def score(errors: ImageErrors) -> float | None:
    """The error that photographs are ranked by: of normals where they are known, else of reconstruction."""
    return errors.rmse if errors.normals is None else errors.normals.mean


def extremes(images: Sequence[ImageErrors]) -> Extremes | None:
    """Rank the photographs of one method; None if it has fewer than three with a score."""
    ranked = sorted((e for e in images if score(e) is not None), key=lambda e: score(e) or 0.0)
    if len(ranked) < 3:
        return None
    count = max(1, round(SHARE * len(ranked)))
    scores = np.array([score(e) for e in ranked])
    names = [n for n in ranked[0].shot.causes if all(n in e.shot.causes for e in ranked)]
    causes = []
    for name in names:
        values = np.array([e.shot.causes[name] for e in ranked])
        varies = np.ptp(values) > 0 and np.ptp(scores) > 0
        rank = float(spearmanr(values, scores).statistic) if varies else float("nan")
        causes.append(
            Cause(
                name, float(values[:count].mean()), float(values.mean()), float(values[-count:].mean()), rank
            )
        )
    unit = "8-bit" if ranked[0].normals is None else "deg"
    return Extremes(ranked[:count], ranked[::-1][:count], causes, unit)


def examples(images: Sequence[ImageErrors], most: int) -> list[ImageErrors]:
    """Some of them, spread evenly, with as many different subjects as there are."""
    seen: set[str] = set()
    fresh = [e for e in images if not (e.shot.subject in seen or seen.add(e.shot.subject))]  # type: ignore[func-returns-value]
    rest = [e for e in images if not any(e is other for other in fresh)]
    chosen = [fresh[place] for place in spread_out(len(fresh), most)]
    return chosen + rest[: most - len(chosen)]


def reason(shot: Shot, images: Sequence[ImageErrors]) -> str:
    """The cause that is furthest above its mean over all photographs, with its value; a word if none is."""
    best, text = _STANDS_OUT, "nothing stands out"
    for name, value in shot.causes.items():
        values = np.array([e.shot.causes[name] for e in images if name in e.shot.causes])
        above = (value - values.mean()) / values.std() if values.std() > 0 else 0.0
        if above > best:
            best, text = float(above), written(name, value)
    return text


def written(name: str, value: float) -> str:
    """A cause with its value and unit: ``cast shadow 31 %``, ``light 95 deg``."""
    return f"{name.removesuffix(' (deg)')} {value:.0f} {'deg' if name.endswith('(deg)') else '%'}"
