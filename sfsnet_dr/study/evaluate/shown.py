"""Which photographs a page shows: none picked by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sfsnet_dr.metrics.light_classes import light_direction
from sfsnet_dr.study.evaluate.measure import ImageErrors, Measured
from sfsnet_dr.study.evaluate.pictures import Pair
from sfsnet_dr.study.evaluate.shots import Shot, spread_out
from sfsnet_dr.study.evaluate.summary import normal_statistics


def leading(found: Sequence[Measured], networks: Sequence[str]) -> str:
    """The method whose pictures are shown: the network with the smallest error, or the best without any.

    Only those that were measured on the most photographs are asked, for fewer may be easier.
    Error is that of normals where they are known, else of the reconstruction, else of the light.
    """
    chosen = [m for m in found if m.method in networks] or list(found)
    most = max(len(m.images) for m in chosen)
    return min((m for m in chosen if len(m.images) == most), key=_error).method


def _error(measured: Measured) -> float:
    images = measured.images
    if images[0].normals is not None:
        return normal_statistics(images)["mean_deg"]
    for field in ("rmse", "light_deg"):
        values = [getattr(e, field) for e in images if getattr(e, field) is not None]
        if values:
            return float(np.mean(values))
    return float("inf")


def shown_first(shots: Sequence[Shot]) -> list[Shot]:
    """A photograph in frontal light, and one of the same person in oblique light; or two people."""
    own = [shot for shot in shots if shot.subject == shots[0].subject and shot.direction is not None]
    if len(own) > 1:
        ordered = sorted(own, key=lambda shot: -float(_direction(shot)[2]))
        return [ordered[0], ordered[int(0.7 * len(ordered))]]
    return [shots[place] for place in spread_out(len(shots), 2)]


def for_decomposition(shots: Sequence[Shot], most: int = 5) -> list[Shot]:
    """Different people, spread evenly over the data; lights from frontal to harsh where they are known."""
    subjects = sorted({shot.subject for shot in shots})
    chosen = []
    for number, place in enumerate(spread_out(len(subjects), most)):
        own = [shot for shot in shots if shot.subject == subjects[place]]
        if own[0].direction is not None:
            own = sorted(own, key=lambda shot: -float(_direction(shot)[2]))
        chosen.append(own[min(len(own) - 1, number * len(own) // max(1, most))])
    return chosen


def for_transfer(images: Sequence[ImageErrors]) -> list[Pair]:
    """Pairs of two people: opposite lights, harsh against frontal light, from above against the side.

    Lights are the true ones where they are known, else those that the method found.
    """
    shots = [e.shot for e in images]
    if len({shot.subject for shot in shots}) < 2:
        return []
    known = all(shot.direction is not None for shot in shots)
    if known:
        ways = np.array([_direction(shot) for shot in shots])
    else:
        ways = light_direction(np.array([e.coefficients for e in images]))
    x, y, z = ways.T
    usable = z > 0.1  # beside and behind the face only a rim is lit
    pairs = []
    for first, second in (
        (-np.abs(x + 0.75), -np.abs(x - 0.75)),  # opposite sides
        (-np.abs(x - 0.9), z),  # harsh from one side against frontal
        (y, -np.abs(x + 0.6)),  # from above against from the side
    ):
        a = _best(first, usable, shots, set())
        b = _best(second, usable, shots, {shots[a].subject})
        pair = Pair(shots[a], shots[b])
        if known:
            pair = Pair(
                shots[a], shots[b], _same(shots, shots[a], shots[b]), _same(shots, shots[b], shots[a])
            )
        pairs.append(pair)
    return pairs


def _best(
    wish: np.typing.NDArray[np.float64],
    usable: np.typing.NDArray[np.bool_],
    shots: Sequence[Shot],
    without: set[str],
) -> int:
    allowed = np.array([shot.subject not in without for shot in shots])
    preferred = allowed & usable
    wish = np.where(preferred if preferred.any() else allowed, wish, -np.inf)
    return int(np.argmax(wish))


def _same(shots: Sequence[Shot], who: Shot, light: Shot) -> Shot | None:
    """The photograph of one person under another's light."""
    for shot in shots:
        if shot.subject == who.subject and shot.light and shot.light == light.light:
            return shot
    return None


def _direction(shot: Shot) -> np.typing.NDArray[np.float64]:
    assert shot.direction is not None
    return shot.direction
