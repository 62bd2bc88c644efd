"""The optional last stage: SfSNet before and after fine-tuning, on subjects that it never saw."""

from __future__ import annotations

from pathlib import Path

from sfsnet_dr.fit.run import WEIGHTS
from sfsnet_dr.report.record import Record
from sfsnet_dr.study.evaluate.choose import Wanted, methods_for
from sfsnet_dr.study.evaluate.collect import Amount, collect
from sfsnet_dr.study.evaluate.run import evaluate
from sfsnet_dr.study.evaluate.unseen import unseen
from sfsnet_dr.study.stages import FINE_TUNED, FINE_TUNED_FROM, Plan


def measure_fine_tuned(plan: Plan, surfaces: Path, command: str) -> list[Record]:
    """Measure both networks and the baselines on the held-back subjects, into ``sfsnet-ft/held-back``."""
    weights = tuple(plan.folder / name / WEIGHTS for name in (FINE_TUNED_FROM, FINE_TUNED))
    collection = collect("labels", [surfaces], Amount())
    methods, _ = methods_for(collection.shots, Wanted(weights=weights), collection.listing)
    return evaluate(unseen(methods, collection), methods, plan.folder / FINE_TUNED / "held-back", command)
