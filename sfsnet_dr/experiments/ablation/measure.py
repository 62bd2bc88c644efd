"""Errors of all ablations' networks on the same faces, each against the first variant's.

Errors are summed for each person first; people are what intervals draw again. A difference is taken between
networks of one seed on the same photographs, so that what is hard for all of them cancels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.core.color_torch import linear_to_srgb
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.dataset import load_faces
from sfsnet_dr.experiments.ablation.config import Case, Plan
from sfsnet_dr.experiments.evaluation.collect import Amount, collect_samples
from sfsnet_dr.experiments.evaluation.measure import measure_methods
from sfsnet_dr.experiments.evaluation.records import by_subject
from sfsnet_dr.experiments.evaluation.samples import Collection
from sfsnet_dr.experiments.pipeline.holdout_split import holdout_faces, rendered_errors
from sfsnet_dr.inference.methods import NetworkMethod
from sfsnet_dr.metrics.bootstrap import bootstrap_interval
from sfsnet_dr.models.inference import LoadedModel
from sfsnet_dr.report.console import progress_bar
from sfsnet_dr.train.logging import read_history
from sfsnet_dr.train.run import HISTORY, WEIGHTS

Array = NDArray[np.float64]
Ends = tuple[float, float]

#: Kinds of data: rendered faces with their truth, photographs with that of photometric stereo.
SYNTHETIC, MEASURED = "synthetic", "measured"

_ANGLES: Final = slice(0, 2)  # weight and sum of angles, of weight, sum of angles and sum below 20 degrees


@dataclass(frozen=True)
class Comparison:
    """A variant on one kind of data.

    Attributes:
        mean: angular error, degrees, with its 95 % interval.
        below20: percent of the pixels below 20 degrees.
        difference: of the mean from the first variant's, with its interval.
        each: the difference of each seed's networks.
        std: standard deviation of the mean over the seeds; None of one.
        difference_std: that of the difference.
    """

    mean: float
    mean_ends: Ends
    below20: float
    difference: float
    difference_ends: Ends
    each: tuple[float, ...]
    std: float | None
    difference_std: float | None


@dataclass(frozen=True, eq=False)
class Measurements:
    """All that was measured.

    Attributes:
        found: kind of data -> variant -> numbers.
        counts: kind of data -> photographs and people.
        losses: variant that differs in who computes the loss alone -> see ``loss_differences``.
    """

    found: Mapping[str, Mapping[str, Comparison]]
    counts: Mapping[str, tuple[int, int]]
    losses: Mapping[str, tuple[float, float]]


def measure_all(plan: Plan) -> Measurements:
    """Put the held-back faces, and the photographs if there are any, to every network."""
    truth, shown = _held(plan)
    collection = None if plan.surfaces is None else collect_samples("labels", [plan.surfaces], Amount())
    kinds = [SYNTHETIC] if collection is None else [SYNTHETIC, MEASURED]
    sums: dict[str, dict[str, list[Array]]] = {kind: {} for kind in kinds}
    with progress_bar("measuring networks", len(plan.cases) * len(plan.spec.seeds)) as advance:
        for case in plan.cases:
            for seed in plan.spec.seeds:
                path = plan.network_folder(plan.network(case), seed) / WEIGHTS
                method = NetworkMethod(case.name, path)
                method.trained = replace(method.trained, encoding=case.recipe.real.encoding)
                sums[SYNTHETIC].setdefault(case.name, []).append(_on_rendered(method.trained, truth, shown))
                if collection is not None:
                    sums[MEASURED].setdefault(case.name, []).append(_on_photographs(method, collection))
                advance()
    found = {
        kind: {name: compare_variants(each, of[plan.base.name]) for name, each in of.items()}
        for kind, of in sums.items()
    }
    counts = {SYNTHETIC: (len(shown), len(set(shown)))}
    if collection is not None:
        counts[MEASURED] = (len(collection.shots), len(collection.subjects))
    losses = {case.name: loss_differences(plan, case) for case in plan.cases if _same_but_loss(plan, case)}
    return Measurements(found, counts, losses)


def compare_variants(own: Sequence[Array], first: Sequence[Array]) -> Comparison:
    """Numbers of a variant whose sums are compared with those of the first.

    Args:
        own: for each seed a row a person, (P, 3): weight, sum of angles, sum of what is below 20 degrees.
        first: likewise, of the same people and seeds.
    """
    rows, others = np.sum(own, axis=0), np.sum(first, axis=0)
    pairs = np.hstack([rows[:, _ANGLES], others[:, _ANGLES]])
    means = [_mean(each) for each in own]
    each = tuple(mean - _mean(other) for mean, other in zip(means, first, strict=True))
    return Comparison(
        mean=_mean(rows),
        mean_ends=bootstrap_interval(rows, _mean),
        below20=float(100 * rows[:, 2].sum() / rows[:, 0].sum()),
        difference=_difference(pairs),
        difference_ends=bootstrap_interval(pairs, _difference),
        each=each,
        std=_std(means),
        difference_std=_std(each),
    )


def loss_differences(plan: Plan, case: Case) -> tuple[float, float]:
    """Greatest difference of the loss from the first variant's: at the first step, and at any, all seeds."""
    first, greatest = 0.0, 0.0
    for seed in plan.spec.seeds:
        lines = [_losses(plan, name, seed) for name in (plan.network(case), plan.base.name)]
        difference = np.abs(lines[0] - lines[1])
        first, greatest = max(first, float(difference[0])), max(greatest, float(np.nanmax(difference)))
    return first, greatest


def _same_but_loss(plan: Plan, case: Case) -> bool:
    own, first = case.recipe.compute.loss_backend, plan.base.recipe.compute.loss_backend
    same = replace(case.recipe, compute=replace(case.recipe.compute, loss_backend=first))
    return own != first and replace(case, recipe=same).training == plan.base.training


def _losses(plan: Plan, name: str, seed: int) -> Array:
    """Of every step; NaN where it was skipped."""
    lines = read_history(plan.network_folder(name, seed) / HISTORY)
    return np.array([line.get("total", np.nan) for line in lines], np.float64)


def _held(plan: Plan) -> tuple[FaceBatch, list[int]]:
    """Pictures of the held-back faces, and which face each shows."""
    data = plan.base.recipe.data
    pictures = holdout_faces(load_faces(plan.held, data.view), data, plan.spec.pictures)
    return pictures.batch(0), pictures.indices(0)


def _on_rendered(trained: LoadedModel, truth: FaceBatch, shown: Sequence[int]) -> Array:
    """(P, 3) sums over the pictures of each face; a network of display-referred values sees them encoded."""
    if trained.encoding == "srgb":
        truth = truth._replace(image=linear_to_srgb(truth.image.clamp(0, 1)))
    numbers = rendered_errors(trained, truth)
    rows = np.stack(
        [np.ones(len(shown)), numbers["normals.mean_deg"], numbers["normals.below20"] / 100], axis=1
    )
    total = np.zeros((max(shown) + 1, 3))
    np.add.at(total, list(shown), rows)
    return total


def _on_photographs(method: NetworkMethod, collection: Collection) -> Array:
    """(P, 3) sums over the pixels of each subject."""
    images = measure_methods(method, collection.shots).images
    sums = [errors.normals.all for errors in images if errors.normals is not None]
    return by_subject(images, np.array(sums))[:, [0, 1, 3]]


def _mean(rows: Array) -> float:
    return float(rows[:, 1].sum() / rows[:, 0].sum())


def _std(values: Sequence[float]) -> float | None:
    return float(np.std(values, ddof=1)) if len(values) > 1 else None


def _difference(pairs: Array) -> float:
    return _mean(pairs[:, :2]) - _mean(pairs[:, 2:])
