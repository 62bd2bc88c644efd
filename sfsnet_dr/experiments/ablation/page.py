"""The page of a set of ablations: what each part is worth in degrees, and what it costs."""

from __future__ import annotations

from typing import Final

from sfsnet_dr.experiments.ablation.config import Case, Plan
from sfsnet_dr.experiments.ablation.ledger import CostLedger
from sfsnet_dr.experiments.ablation.measure import MEASURED, SYNTHETIC, Comparison, Measurements, measure_all
from sfsnet_dr.experiments.ablation.records import ablation_records
from sfsnet_dr.experiments.pipeline.holdout_split import find_record
from sfsnet_dr.report.html import Block, Figure, Note, Section, Table, write_page
from sfsnet_dr.report.plots import Difference, difference_plot
from sfsnet_dr.report.record import Record, all_numbers, write_records

_LEAD = (
    "Networks that differ from the first in one thing each, trained alike and measured on the same faces, "
    "which none of them saw: what the thing is worth in degrees, and what it costs to render."
)
_KINDS: Final = {SYNTHETIC: "rendered faces", MEASURED: "photographs"}


def write_results(plan: Plan, ledger: CostLedger, command: str) -> list[Record]:
    """Measure all networks, and write ``records.json`` and ``index.html``."""
    found = measure_all(plan)
    records = ablation_records(plan, found, ledger, command)
    write_records(plan.folder / "records.json", records)
    sections = [_summary(plan, found, records), _variants(plan), all_numbers(records, "people")]
    if found.losses:
        sections.insert(2, _losses(plan, found))
    footer = ", ".join(f"{name} {number}" for name, number in records[0].versions.items())
    write_page(plan.folder / "index.html", "Ablations", _LEAD, sections, footer=footer)
    return records


def _summary(plan: Plan, found: Measurements, records: list[Record]) -> Section:
    headers = ["variant", "s a face", "s training"]
    for kind in found.found:
        headers += [f"{_KINDS[kind]}, °", "difference, °", "below 20°, %"]
    rows = [_row(plan, case, found, records) for case in plan.cases]
    others = [case.name for case in plan.cases[1:]]
    blocks: list[Block] = [Table(headers, rows, _caption(found))]
    if others:
        kinds = {
            f"on {_KINDS[kind]}": {
                name: Difference(of[name].difference, of[name].difference_ends, of[name].each)
                for name in others
            }
            for kind, of in found.found.items()
        }
        blocks.append(
            Figure(
                difference_plot(others, kinds, label=f"degrees more than {plan.base.name}"),
                "Mean angular error less that of the first variant, on the same faces: to the right of the "
                "line is worse. Bars are 95 % intervals over people"
                + ("; rings are single seeds." if len(plan.spec.seeds) > 1 else "."),
            )
        )
    return Section("In short", [*blocks, Note(_chance(plan, found))])


def _caption(found: Measurements) -> str:
    parts = [
        f"{images} images of {people} {'people' if kind == MEASURED else 'faces'} ({_KINDS[kind]})"
        for kind, (images, people) in found.counts.items()
    ]
    return (
        f"Mean angle of the normals to the true ones over {' and '.join(parts)}, the difference from the "
        "first variant, each with its 95 % interval over people, and the share of pixels below 20 degrees. "
        "Cost: processor seconds, all threads together, of rendering one face (median) and of one training; "
        "a dash where the networks of another variant are measured."
    )


def _chance(plan: Plan, found: Measurements) -> str:
    seeds = len(plan.spec.seeds)
    if seeds == 1:
        return (
            "Every variant was trained once. The intervals tell how much it matters which faces were "
            "measured, not what another seed of the training would have given: a difference means nothing "
            "until it is known to exceed what chance alone makes of two trainings. More `seeds` tell; a "
            "variant that differs in rounding alone gives a first idea."
        )
    spreads = [
        f"{max(numbers.difference_std or 0.0 for numbers in of.values()):.2f}° on {_KINDS[kind]}"
        for kind, of in found.found.items()
    ]
    return (
        f"Every variant was trained from {seeds} seeds. Between seeds a variant's difference varies with a "
        f"standard deviation of up to {' and '.join(spreads)}. A difference below that is what chance alone "
        "makes of two trainings, and says nothing about the variant, however narrow its interval is."
    )


def _row(plan: Plan, case: Case, found: Measurements, records: list[Record]) -> list[str]:
    row = [case.name]
    for what, digits in (("seconds_per_face", 2), ("training_seconds", 0)):
        record = find_record(records, f"ablations.{case.name}.{what}")
        row.append("-" if record is None else f"{record.value:.{digits}f}")
    for of in found.found.values():
        numbers = of[case.name]
        row += [
            f"{numbers.mean:.2f} ({_between(numbers.mean_ends)})",
            "-" if case is plan.base else _difference(numbers),
            f"{numbers.below20:.1f}",
        ]
    return row


def _difference(numbers: Comparison) -> str:
    return f"{numbers.difference:+.2f} ({_between(numbers.difference_ends)})"


def _between(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.2f} to {ends[1]:.2f}"


def _variants(plan: Plan) -> Section:
    spec = plan.spec
    recipe = plan.base.recipe
    rows = [[variant.name, variant.why] for variant in spec.variants]
    blocks: list[Block] = [
        f"Each network learns from {spec.faces} faces, {recipe.steps} steps of {recipe.batch_size} images of "
        f"{recipe.data.size} x {recipe.data.size} pixels; the faces to measure on are of the first variant's "
        "scene, whatever a variant learnt from.",
        Table(["variant", "why"], rows),
    ]
    for case in plan.cases:
        network, rendered = plan.network(case), plan.rendered(case)
        if network != case.name:
            blocks.append(f"{case.name}: training sees no difference, so {network}'s networks are measured.")
        elif not case.variant.visibility:
            blocks.append(
                f"{case.name}: learns from {rendered}'s faces with their responses to light replaced by "
                "Lambert's law; gloss under smooth light stays, highlights of lamps go with their shadows."
            )
    blocks += [Note(f"{name} was left out: it {why}.") for name, why in plan.left_out.items()]
    return Section("Variants", blocks)


def _losses(plan: Plan, found: Measurements) -> Section:
    rows = [[name, f"{first:.2g}", f"{greatest:.2g}"] for name, (first, greatest) in found.losses.items()]
    caption = (
        f"Greatest difference of the training loss from {plan.base.name}'s. The first step shows how far the "
        "two losses agree; from then on the networks differ by rounding, which training lets grow."
    )
    return Section(
        "The same loss, computed elsewhere", [Table(["variant", "first step", "any step"], rows, caption)]
    )
