"""Measure every network of a set of stages on the same validation faces and photographs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.dataset import load_faces
from sfsnet_dr.data.photos import PhotoSet, PhotoSource
from sfsnet_dr.data.pseudo_labels import MANIFEST
from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.experiments.evaluation.collect import Amount, collect_samples
from sfsnet_dr.experiments.evaluation.methods import RequestedMethod, methods_for
from sfsnet_dr.experiments.evaluation.run import evaluate
from sfsnet_dr.experiments.evaluation.splits import unseen_subjects
from sfsnet_dr.experiments.pipeline.config import FINE_TUNED, FINE_TUNED_FROM, NETWORKS, Plan
from sfsnet_dr.experiments.pipeline.holdout_split import (
    Numbers,
    error_records,
    holdout_batch,
    photograph_errors,
    rendered_errors,
)
from sfsnet_dr.models.inference import LoadedModel, load_model
from sfsnet_dr.report.console import progress_bar
from sfsnet_dr.report.record import Record, make_record
from sfsnet_dr.train.logging import read_history
from sfsnet_dr.train.run import HISTORY, WEIGHTS

#: First words of the records of photographs, and of rendered faces that stood in for them.
PHOTOGRAPHS: Final = {False: "photographs", True: "stand_ins"}


@dataclass(frozen=True, eq=False)
class Outcome:
    """Everything that the page shows.

    Attributes:
        plan: what was to be done.
        source: the photographs.
        trained: networks by name.
        histories: a line for each step of each.
        truth: held-back rendered faces.
        photographs: held-back photographs.
        errors: of each network on these.
        labels: manifest of the pseudo-labels.
        records: every number.
    """

    plan: Plan
    source: PhotoSource
    trained: Mapping[str, LoadedModel]
    histories: Mapping[str, list[dict[str, Any]]]
    truth: FaceBatch
    photographs: PhotoSet
    errors: Mapping[str, Numbers]
    labels: dict[str, Any]
    records: tuple[Record, ...]


def measure_networks(plan: Plan, source: PhotoSource, command: str) -> Outcome:
    """Load and measure every network of a plan whose stages are done."""
    trained = {name: load_model(plan.folder / name / WEIGHTS) for name in NETWORKS}
    histories = {name: read_history(plan.folder / name / HISTORY) for name in NETWORKS}
    data = plan.first.data
    held = load_faces(plan.faces, data.view, held_back=data.num_val, held=True)
    truth = holdout_batch(held, data, plan.spec.pictures)
    photographs = source.load(source.held, Crop(truth.image.shape[-1], data.crop))
    records: list[Record] = []
    errors = {}
    kind = PHOTOGRAPHS[source.rendered]
    with progress_bar("measuring networks", len(trained)) as advance:
        for name, network in trained.items():
            errors[name] = photograph_errors(network, photographs)
            records += error_records(rendered_errors(network, truth), "synthetic", name, command)
            records += error_records(errors[name], kind, name, command)
            records += _of_training(name, histories[name], plan.recipes[name].batch_size, command)
            advance()
    labels: dict[str, Any] = json.loads((plan.labels / MANIFEST).read_text(encoding="utf-8"))
    counts = {
        "labelled": labels["labelled"],
        "skipped": len(labels["skipped"]),
        "held_back": len(photographs),
    }
    records += [make_record(f"pseudo_label.{n}", count, kind, command=command) for n, count in counts.items()]
    return Outcome(plan, source, trained, histories, truth, photographs, errors, labels, tuple(records))


def training_seconds(history: list[dict[str, Any]], batch_size: int) -> float:
    """Time that the steps took, without checkpoints and preparation."""
    speeds = (line["images_per_second"] for line in history if "images_per_second" in line)
    return float(sum(batch_size / speed for speed in speeds))


def _of_training(name: str, history: list[dict[str, Any]], batch_size: int, command: str) -> list[Record]:
    steps = [line for line in history if "total" in line]
    seconds = training_seconds(history, batch_size)
    speed = float(np.median([line["images_per_second"] for line in steps]))
    final = float(np.mean([line["total"] for line in steps[-20:]]))
    values = {
        "steps": (len(steps), "steps"),
        "skipped": (len(history) - len(steps), "steps"),
        "seconds": (seconds, "s"),
        "images_per_s": (speed, "1/s"),
        "loss": (final, "1"),
    }
    return [
        make_record(f"stages.{key}.{name}", value, unit, command=command)
        for key, (value, unit) in values.items()
    ]


def measure_fine_tuned(plan: Plan, surfaces: Path, command: str) -> list[Record]:
    """Measure both networks and the baselines on the held-back subjects, into ``sfsnet-ft/held-back``."""
    weights = tuple(plan.folder / name / WEIGHTS for name in (FINE_TUNED_FROM, FINE_TUNED))
    collection = collect_samples("labels", [surfaces], Amount())
    methods, _ = methods_for(collection.shots, RequestedMethod(weights=weights), collection.listing)
    return evaluate(
        unseen_subjects(methods, collection), methods, plan.folder / FINE_TUNED / "held-back", command
    )
