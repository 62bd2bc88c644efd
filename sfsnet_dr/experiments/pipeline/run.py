"""``sfsnet-dr train-all``: SfS-supervision from rendered faces to measured networks, one resumable command.

Source: Sengupta et al., CVPR 2018, section 3.1: SkipNet learns from rendered faces, its answers label
photographs, and SfSNet learns from both; the networks that the paper compares with follow.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from rich.console import Console

from sfsnet_dr.core.files import output_dir
from sfsnet_dr.data.dataset import load_faces
from sfsnet_dr.data.photos import PhotoSource, photo_folder, rendered_stand_ins
from sfsnet_dr.data.pseudo_labels import MANIFEST as LABELS_MANIFEST
from sfsnet_dr.experiments.pipeline.cache import label_photographs, render_missing, train_once
from sfsnet_dr.experiments.pipeline.config import FINE_TUNED, FINE_TUNED_FROM, LABELLER, NETWORKS, Plan
from sfsnet_dr.experiments.pipeline.measure import measure_fine_tuned
from sfsnet_dr.experiments.pipeline.page import write_results
from sfsnet_dr.report.record import Record
from sfsnet_dr.train.run import WEIGHTS


def run_stages(plan: Plan, *, command: str, console: Console | None = None) -> list[Record]:
    """Run the stages that are not done yet, measure all networks, and write ``index.html``.

    Everything that a stage made is kept under the plan's folder; a stage that was stopped is continued,
    one that is done from the same recipe, faces and labels is not run again.

    Args:
        plan: of ``read_plan``.
        command: for the records.
        console: where progress is shown; standard error by default.

    Raises:
        InputError: for unusable data, or a folder in which a stage was done from something else.
        RunError: if training failed or was told to stop; the same call goes on.
    """
    begin = time.perf_counter()
    screen = console or Console(stderr=True)
    folder = output_dir(plan.folder)
    if plan.photographs is not None:  # unusable ones are told before anything is rendered
        photo_folder(plan.photographs, held_back=plan.spec.num_val, most=plan.spec.photographs)
    steps = ["faces", LABELLER, "pseudo-label", *NETWORKS[1:], "measure", FINE_TUNED]

    def rule(name: str, state: str) -> None:
        screen.rule(f"{steps.index(name) + 1}/{len(steps)}  {name}: {state}", align="left")

    _render(plan, rule)
    source: PhotoSource | None = None
    for name in NETWORKS:
        if name == NETWORKS[1]:
            source = load_photographs(plan)
            _label(plan, source, rule)
        _train(plan, name, folder / name, rule)
    assert source is not None
    rule("measure", "held-back faces and photographs")
    records = write_results(plan, source, command, begin)
    if plan.surfaces is None:
        rule(FINE_TUNED, "left out; --normal-labels gives labels by photometric stereo to fine-tune on")
        return records
    _train(plan, FINE_TUNED, folder / FINE_TUNED, rule)
    return [*records, *measure_fine_tuned(plan, plan.surfaces, command)]


def load_photographs(plan: Plan) -> PhotoSource:
    """The plan's photographs, or the rendered faces that stand in for them."""
    spec, data = plan.spec, plan.first.data
    if plan.photographs is not None:
        return photo_folder(plan.photographs, held_back=spec.num_val, most=spec.photographs)
    train_faces = load_faces(plan.faces, data.view, held_back=data.num_val)
    held = load_faces(plan.faces, data.view, held_back=data.num_val, held=True)
    most = spec.photographs or 4 * len(train_faces)
    return rendered_stand_ins(train_faces, held, data, held_back=spec.num_val, most=most)


def _render(plan: Plan, rule: Callable[[str, str], None]) -> None:
    if plan.data:
        rule("faces", "given")
        return
    [folder] = plan.faces
    render_missing(folder, plan.scene, plan.spec.faces, partial(rule, "faces"))


def _label(plan: Plan, source: PhotoSource, rule: Callable[[str, str], None]) -> None:
    done = (plan.labels / LABELS_MANIFEST).is_file()
    rule("pseudo-label", "done before" if done else f"{len(source.train)} photographs by {LABELLER}")
    label_photographs(source, plan.folder / LABELLER / WEIGHTS, plan.labels)


def _train(plan: Plan, name: str, folder: Path, rule: Callable[[str, str], None]) -> None:
    recipe = plan.recipes[name]
    labels = plan.labels if recipe.real.batch_fraction else None
    surfaces = plan.surfaces if recipe.normal_labels.batch_fraction else None
    start = plan.folder / FINE_TUNED_FROM / WEIGHTS if name == FINE_TUNED else None
    train_once(recipe, plan.faces, folder, partial(rule, name), labels=labels, surfaces=surfaces, start=start)
