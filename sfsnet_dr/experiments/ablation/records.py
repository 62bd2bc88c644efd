"""Records of a set of ablations: errors, differences from the first variant, and costs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from sfsnet_dr.experiments.ablation.config import Case, Plan
from sfsnet_dr.experiments.ablation.ledger import CostLedger, labelling_entry, rendering_entry, training_entry
from sfsnet_dr.experiments.ablation.measure import Comparison, Measurements
from sfsnet_dr.report.record import Record, make_record

_One = Callable[..., Record]


def ablation_records(plan: Plan, found: Measurements, ledger: CostLedger, command: str) -> list[Record]:
    """Every number as ``ablations.<variant>....``; processor seconds count all threads."""
    one = partial(make_record, command=command)
    records = []
    for kind, (images, people) in found.counts.items():
        records.append(one(f"ablations.data.{kind}.images", images, "images"))
        records.append(one(f"ablations.data.{kind}.people", people, "people"))
    for case in plan.cases:
        head = f"ablations.{case.name}"
        records += _costs(one, plan, case, ledger)
        for kind, of in found.found.items():
            records += _normals(one, f"{head}.{kind}.normals", of[case.name], case is plan.base)
        if case.name in found.losses:
            first, greatest = found.losses[case.name]
            records.append(one(f"{head}.loss.first_difference", first, "1"))
            records.append(one(f"{head}.loss.greatest_difference", greatest, "1"))
    return records


def _costs(one: _One, plan: Plan, case: Case, ledger: CostLedger) -> list[Record]:
    """The median of rendering a face, which leaves out what compiles with the first; means of the rest."""
    seeds = plan.spec.seeds
    rendered = ledger.seconds(rendering_entry(plan, plan.priced(case)))
    own = plan.network(case) == case.name
    parts = {
        "seconds_per_face": float(np.median(rendered)) if rendered else 0.0,
        "training_seconds": _mean_seconds(ledger, [training_entry(case.name, s) for s in seeds])
        if own
        else 0.0,
        "labelling_seconds": _mean_seconds(ledger, [labelling_entry(case.name, s) for s in seeds]),
    }
    return [one(f"ablations.{case.name}.{name}", value, "s") for name, value in parts.items() if value]


def _mean_seconds(ledger: CostLedger, works: Sequence[str]) -> float:
    return float(np.mean([sum(ledger.seconds(work)) for work in works]))


def _normals(one: _One, head: str, numbers: Comparison, base: bool) -> list[Record]:
    records = [
        one(f"{head}.mean_deg", numbers.mean, "degrees", interval=numbers.mean_ends),
        one(f"{head}.below20", numbers.below20, "%"),
    ]
    if not base:
        ends = numbers.difference_ends
        records.append(one(f"{head}.difference_deg", numbers.difference, "degrees", interval=ends))
        if numbers.difference_std is not None:
            records.append(one(f"{head}.difference_seed_std_deg", numbers.difference_std, "degrees"))
    if numbers.std is not None:
        records.append(one(f"{head}.seed_std_deg", numbers.std, "degrees"))
    return records
