"""Render the faces of all ablations, train their networks, and measure them; each step once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from rich.console import Console

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import output_dir
from sfsnet_dr.data.manifest import Manifest
from sfsnet_dr.data.normal_labels import read_index
from sfsnet_dr.data.photos import photo_folder
from sfsnet_dr.data.unshadowed import remove_visibility
from sfsnet_dr.experiments.ablation.config import HELD_SEED, Case, Plan
from sfsnet_dr.experiments.ablation.ledger import CostLedger, labelling_entry, rendering_entry, training_entry
from sfsnet_dr.experiments.ablation.page import write_results
from sfsnet_dr.experiments.pipeline.cache import label_photographs, render_missing, train_once
from sfsnet_dr.report.record import Record
from sfsnet_dr.scene.spec import SceneSpec
from sfsnet_dr.train.run import WEIGHTS

#: Faces rendered in one go: few enough for ``data.workers`` to do it in this process, whose time counts.
_AT_ONCE: Final = 100

Rule = Callable[[str, str], None]


def run_ablations(plan: Plan, *, command: str, console: Console | None = None) -> list[Record]:
    """Do what is not done yet, measure all networks, and write ``records.json`` and ``index.html``.

    Args:
        plan: of ``read_ablations``.
        command: for the records.
        console: where progress is shown; standard error by default.

    Raises:
        InputError: for unusable data, or a folder that holds other faces or networks.
        RunError: if rendering or training failed; the same call goes on.
    """
    screen = console or Console(stderr=True)
    output_dir(plan.folder)
    if plan.surfaces is not None:  # unusable ones are told before anything is rendered
        read_index(plan.surfaces)
    if plan.photographs is not None:
        photo_folder(plan.photographs, held_back=0, most=plan.spec.photographs)
    ledger = CostLedger(plan.folder / "seconds.jsonl")

    def rule(name: str, state: str) -> None:
        screen.rule(f"{name}: {state}", align="left")

    _render_all(plan, ledger, rule)
    for case in plan.cases:
        if plan.network(case) == case.name:
            for seed in plan.spec.seeds:
                _train(plan, case, seed, ledger, rule)
    rule("measure", "held-back faces" if plan.surfaces is None else "held-back faces and photographs")
    return write_results(plan, ledger, command)


def _render_all(plan: Plan, ledger: CostLedger, rule: Rule) -> None:
    spec = plan.spec
    _render(plan, plan.held, plan.base.scene, range(HELD_SEED, HELD_SEED + spec.held), ledger, rule)
    for case in plan.cases:
        rendered = plan.folder / "faces" / plan.rendered(case)
        if rendered.name == case.name:
            _render(plan, rendered, case.scene, range(spec.faces), ledger, rule)
        if not case.variant.visibility:
            rule(f"{case.name}", "taking shadows away")
            remove_visibility(rendered, plan.faces(case))
        if case.price is not None:
            _render(plan, plan.priced(case), case.price, range(spec.priced), ledger, rule)


def _render(plan: Plan, folder: Path, scene: SceneSpec, seeds: range, ledger: CostLedger, rule: Rule) -> None:
    what = rendering_entry(plan, folder)
    found = len(Manifest(folder).entries)
    if found > len(seeds):
        raise InputError(
            f"{folder}: {found} faces found, {len(seeds)} asked for; choose another --out, or remove the "
            "folder"
        )
    ledger.start()
    for begin in range(0, len(seeds), _AT_ONCE):
        part = seeds[begin : begin + _AT_ONCE]
        render_missing(
            folder, scene, len(part), partial(rule, what), seed=part[0], on_face=lambda: ledger.note(what)
        )


def _train(plan: Plan, case: Case, seed: int, ledger: CostLedger, rule: Rule) -> None:
    recipe = replace(case.recipe, seed=seed)
    labels: Path | None = None
    if recipe.real.batch_fraction:
        assert plan.photographs is not None
        source = photo_folder(plan.photographs, held_back=0, most=plan.spec.photographs)
        labels = plan.folder / "labels" / f"{case.name}-{seed}"
        rule(labelling_entry(case.name, seed), f"{len(source.train)} photographs by {plan.base.name}")
        weights = plan.network_folder(plan.base.name, seed) / WEIGHTS
        with ledger.spent(labelling_entry(case.name, seed)):
            label_photographs(source, weights, labels, recipe.real.encoding)
    what, folder = training_entry(case.name, seed), plan.network_folder(case.name, seed)
    with ledger.spent(what):
        train_once(recipe, [plan.faces(case)], folder, partial(rule, what), labels=labels)
