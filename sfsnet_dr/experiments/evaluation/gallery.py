"""Sheets of photographs with what each method makes of them, chosen by rule, not by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from sfsnet_dr.core.color_torch import linear_to_srgb, srgb_to_linear
from sfsnet_dr.core.visualize import Pixels, on_white, show_albedo, show_linear, show_normals
from sfsnet_dr.experiments.evaluation.failure_cases import FailureCause, describe_failure, failure_score
from sfsnet_dr.experiments.evaluation.measure import ImageErrors, MethodErrors, run_method
from sfsnet_dr.experiments.evaluation.records import normal_statistics
from sfsnet_dr.experiments.evaluation.samples import EvaluationSample, spread_out
from sfsnet_dr.inference.methods import Method, NetworkMethod, Prediction
from sfsnet_dr.inference.relight import VIEW_LIGHTS, directional_shading
from sfsnet_dr.inference.sheet import SheetStyle, draw_sheet
from sfsnet_dr.metrics.light import light_direction
from sfsnet_dr.metrics.normals import angles_deg
from sfsnet_dr.render.shading_torch import shading
from sfsnet_dr.report.plots import error_colours

Array = npt.NDArray[np.float64]
Cell = tuple[str, Pixels]

#: Angle (degrees) at which a map of errors is darkest.
DARKEST: Final = 40.0

_NOTHING: Final[Cell] = ("", np.full((128, 128, 3), 255, np.uint8))


def _sheet(cells: Sequence[Cell], columns: int, shots: Sequence[EvaluationSample]) -> bytes:
    """Cells of twice the page's pixels, cut to the square that holds all of what the photographs show."""
    cell = min(286, (1840 - 24 * (columns - 1)) // columns)
    style = SheetStyle(cell=cell, gap=24, margin=4, label=44, text=17 if columns <= 6 else 15)
    shown = np.max([shot.shown for shot in shots], axis=0) > 0.5
    rows, across = (np.flatnonzero(shown.any(axis)) for axis in (1, 0))
    side = int(max(np.ptp(rows), np.ptp(across))) + 1
    top, left = (
        int(np.clip((ends[0] + ends[-1] + 1 - side) // 2, 0, len(shown) - side)) for ends in (rows, across)
    )
    cut = [(label, picture[top : top + side, left : left + side]) for label, picture in cells]
    return draw_sheet(cut, columns=columns, style=style)


def side_by_side(methods: Sequence[Method], shots: Sequence[EvaluationSample]) -> bytes:
    """Two photographs with their truth; a method a row, named under its normals, albedo, reconstruction."""
    shots = shots[:2]
    cells: list[Cell] = []
    for shot in shots:
        cells += [(shot.light or "photograph", sample_photograph(shot))]
        cells += [_known_normals(shot), _known_albedo(shot)]
    for method in methods:
        for shot in shots:
            answer = run_method(method, [shot])
            word = "" if answer.divided else "reconstruction"
            cells += [
                (method.name, _normals(answer, 0, shot)),
                ("albedo", _albedo(answer, 0, shot)),
                (word, _drawn(answer, 0, shot)) if word else _NOTHING,
            ]
    return _sheet(cells, 3 * len(shots), shots)


def decomposition_rows(method: Method, shots: Sequence[EvaluationSample]) -> bytes:
    """A row a photograph: normals, albedo, shading, reconstruction, and three relit views."""
    answer = run_method(method, shots)
    cells: list[Cell] = []
    for index, shot in enumerate(shots):
        shade = shading(answer.normal, answer.light)[index]
        cells += [
            (shot.light or "photograph", sample_photograph(shot)),
            ("normals", _normals(answer, index, shot)),
            ("albedo", _albedo(answer, index, shot)),
            ("shading", _scaled(shade, shot)),
            ("reconstruction", _drawn(answer, index, shot)),
        ]
        for side, way in VIEW_LIGHTS.items():
            light = torch.from_numpy(directional_shading(way).flat()).float()
            cells.append((f"lit from the {side}", _scaled(_under(method, answer, index, light), shot)))
    return _sheet(cells, 8, shots)


@dataclass(frozen=True, eq=False)
class Pair:
    """Two photographs whose lights are exchanged, and each face in the other's light if that was taken."""

    first: EvaluationSample
    second: EvaluationSample
    first_so: EvaluationSample | None = None
    second_so: EvaluationSample | None = None


def light_transfer_rows(method: Method, pairs: Sequence[Pair]) -> bytes:
    """A row a pair: both photographs, each with the other's light, and the photograph of that if there is."""
    cells: list[Cell] = []
    with_truth = any(pair.first_so is not None for pair in pairs)
    for pair in pairs:
        answer = run_method(method, [pair.first, pair.second])
        photos = [("A", pair.first), ("B", pair.second)]
        cells += [
            (f"{word}: {shot.light}" if shot.light else word, sample_photograph(shot))
            for word, shot in photos
        ]
        for index, shot, other, so, words in (
            (0, pair.first, 1, pair.first_so, ("A in the light of B", "A photographed so")),
            (1, pair.second, 0, pair.second_so, ("B in the light of A", "B photographed so")),
        ):
            moved = _under(method, answer, index, answer.light[other])
            cells.append((words[0], on_white(show_linear(_picture(moved)), shot.mask[0].numpy())))
            if with_truth:
                cells.append(_NOTHING if so is None else (words[1], sample_photograph(so)))
    return _sheet(cells, 6 if with_truth else 4, [shot for p in pairs for shot in (p.first, p.second)])


def rank_samples(
    method: Method, chosen: Sequence[ImageErrors], unit: str, why: Sequence[FailureCause] = ()
) -> bytes:
    """A row of each: the photograph with its error, what the method found, and where it is wrong.

    Args:
        method: which.
        chosen: photographs with its errors.
        unit: of the errors.
        why: causes of which the strongest is named below the last picture, if given.
    """
    answer = run_method(method, [e.shot for e in chosen])
    cells: list[Cell] = []
    for index, errors in enumerate(chosen):
        shot = errors.shot
        name = f"{shot.light}: " if shot.light else ""
        cells.append((f"{name}{failure_score(errors):.1f} {unit}", sample_photograph(shot)))
        cells.append(("normals found", _normals(answer, index, shot)))
        if shot.normal is not None:
            cells += [_known_normals(shot), (f"error, dark: {DARKEST:.0f} deg", _error(answer, index, shot))]
        cells.append(("albedo", _albedo(answer, index, shot)))
        cells.append(("reconstruction", _drawn(answer, index, shot)))
        if shot.normal is None:
            light = torch.from_numpy(directional_shading(VIEW_LIGHTS["left"]).flat()).float()
            cells.append(("lit from the left", _scaled(_under(method, answer, index, light), shot)))
        if why:
            cells[-1] = (describe_failure(shot, why), cells[-1][1])
    return _sheet(cells, len(cells) // len(chosen), [errors.shot for errors in chosen])


def sample_photograph(shot: EvaluationSample) -> Pixels:
    """The photograph, white beyond its border."""
    return on_white(show_linear(_picture(shot.image)), shot.shown)


def _under(method: Method, answer: Prediction, index: int, light: Tensor) -> Tensor:
    """A face under another light of the same method, linear (3, S, S).

    Networks of display-referred values multiply encoded albedo and shading.
    """
    shade = shading(answer.normal[index : index + 1], light[None])[0].clamp_min(0)
    if isinstance(method, NetworkMethod) and method.trained.encoding == "srgb":
        return srgb_to_linear((linear_to_srgb(answer.albedo[index].clamp_min(0)) * shade).clamp(0, 1))
    return answer.albedo[index] * shade


def _normals(answer: Prediction, index: int, shot: EvaluationSample) -> Pixels:
    return on_white(show_normals(_picture(answer.normal[index])), shot.mask[0].numpy())


def _albedo(answer: Prediction, index: int, shot: EvaluationSample) -> Pixels:
    mask = shot.mask[0].numpy()
    return on_white(show_albedo(_picture(answer.albedo[index]), mask), mask)


def _drawn(answer: Prediction, index: int, shot: EvaluationSample) -> Pixels:
    return on_white(show_linear(_picture(answer.image[index])), shot.mask[0].numpy())


def _scaled(planes: Tensor, shot: EvaluationSample) -> Pixels:
    mask = shot.mask[0].numpy()
    return on_white(show_albedo(_picture(planes).clip(0), mask), mask)


def _known_normals(shot: EvaluationSample) -> Cell:
    if shot.normal is None:
        return _NOTHING
    return "normals known", on_white(show_normals(_picture(shot.normal)), shot.mask[0].numpy())


def _known_albedo(shot: EvaluationSample) -> Cell:
    if shot.albedo is None:
        return _NOTHING
    mask = shot.mask[0].numpy()
    return "albedo known", on_white(show_albedo(_picture(shot.albedo), mask), mask)


def _error(answer: Prediction, index: int, shot: EvaluationSample) -> Pixels:
    assert shot.normal is not None
    angles = angles_deg(_picture(answer.normal[index]), _picture(shot.normal))
    return error_colours(np.where(shot.mask[0].numpy() > 0.5, angles, np.nan), DARKEST)


def _picture(planes: Tensor) -> Array:
    return np.moveaxis(np.nan_to_num(planes.double().numpy()), 0, -1)


def leading_methods(found: Sequence[MethodErrors], networks: Sequence[str]) -> str:
    """The method whose pictures are shown: the network with the smallest error, or the best without any.

    Only those that were measured on the most photographs are asked, for fewer may be easier.
    Error is that of normals where they are known, else of the reconstruction, else of the light.
    """
    chosen = [m for m in found if m.method in networks] or list(found)
    most = max(len(m.images) for m in chosen)
    return min((m for m in chosen if len(m.images) == most), key=_shown_error).method


def _shown_error(measured: MethodErrors) -> float:
    images = measured.images
    if images[0].normals is not None:
        return normal_statistics(images)["mean_deg"]
    for field in ("rmse", "light_deg"):
        values = [getattr(e, field) for e in images if getattr(e, field) is not None]
        if values:
            return float(np.mean(values))
    return float("inf")


def first_samples(shots: Sequence[EvaluationSample]) -> list[EvaluationSample]:
    """A photograph in frontal light, and one of the same person in oblique light; or two people."""
    own = [shot for shot in shots if shot.subject == shots[0].subject and shot.direction is not None]
    if len(own) > 1:
        ordered = sorted(own, key=lambda shot: -float(_direction(shot)[2]))
        return [ordered[0], ordered[int(0.7 * len(ordered))]]
    return [shots[place] for place in spread_out(len(shots), 2)]


def samples_for_decomposition(shots: Sequence[EvaluationSample], most: int = 5) -> list[EvaluationSample]:
    """Different people, spread evenly over the data; lights from frontal to harsh where they are known."""
    subjects = sorted({shot.subject for shot in shots})
    chosen = []
    for number, place in enumerate(spread_out(len(subjects), most)):
        own = [shot for shot in shots if shot.subject == subjects[place]]
        if own[0].direction is not None:
            own = sorted(own, key=lambda shot: -float(_direction(shot)[2]))
        chosen.append(own[min(len(own) - 1, number * len(own) // max(1, most))])
    return chosen


def samples_for_transfer(images: Sequence[ImageErrors]) -> list[Pair]:
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
    shots: Sequence[EvaluationSample],
    without: set[str],
) -> int:
    allowed = np.array([shot.subject not in without for shot in shots])
    preferred = allowed & usable
    wish = np.where(preferred if preferred.any() else allowed, wish, -np.inf)
    return int(np.argmax(wish))


def _same(
    shots: Sequence[EvaluationSample], who: EvaluationSample, light: EvaluationSample
) -> EvaluationSample | None:
    """The photograph of one person under another's light."""
    for shot in shots:
        if shot.subject == who.subject and shot.light and shot.light == light.light:
            return shot
    return None


def _direction(shot: EvaluationSample) -> np.typing.NDArray[np.float64]:
    assert shot.direction is not None
    return shot.direction
