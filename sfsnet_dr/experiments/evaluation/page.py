"""The page of an evaluation: tables first, then figures, pictures, and what was left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from sfsnet_dr.experiments.evaluation.failure_cases import SHARE, Extremes, example_rows, find_extremes
from sfsnet_dr.experiments.evaluation.gallery import (
    decomposition_rows,
    first_samples,
    leading_methods,
    light_transfer_rows,
    rank_samples,
    samples_for_decomposition,
    samples_for_transfer,
    side_by_side,
)
from sfsnet_dr.experiments.evaluation.measure import REGIONS, MethodErrors
from sfsnet_dr.experiments.evaluation.records import (
    BINS,
    bin_name,
    light_classification,
    region_name,
    result_tables,
)
from sfsnet_dr.experiments.evaluation.samples import Collection
from sfsnet_dr.experiments.evaluation.splits import provenance_notes, shown_together, without_folds
from sfsnet_dr.inference.methods import Method, NetworkMethod
from sfsnet_dr.report.html import Block, Figure, Section, Table, write_page
from sfsnet_dr.report.plots import lines_by_group
from sfsnet_dr.report.record import Record, dotted_word

#: Rows of what was left out that the page shows; the records count all.
_SHOWN: Final = 40
_EXAMPLES: Final = 4

#: What data are called in headings, where their name in records says too little.
TITLES: Final = {
    "yale-b": "Extended Yale B",
    "photoface": "Photoface",
    "celeba": "CelebA",
    "multipie": "MultiPIE",
    "folder": "a folder of photographs",
    "synthetic": "rendered faces",
}


def write_pages(
    folder: Path,
    collection: Collection,
    methods: Sequence[Method],
    names: Sequence[str],
    found: Sequence[MethodErrors],
    records: Sequence[Record],
) -> None:
    """Write ``index.html`` into a folder; ``names`` are the tables' rows."""
    networks = [method.name for method in methods if isinstance(method, NetworkMethod)]
    lead = leading_methods(found, networks)
    place = [method.name for method in methods].index(lead)
    method, measured = methods[place], found[place]
    sections = [
        Section(
            "In numbers",
            [
                *result_tables(collection.data, names, records),
                *provenance_notes(methods, collection),
                *_notes(collection, found),
            ],
        )
    ]
    figures = _by_group(collection.data, without_folds(names), records)
    if figures:
        sections.append(Section("Where errors are", figures))
    together, theirs = shown_together(methods, method, collection)
    sections += _pictures(theirs, together, method, measured)
    if collection.skipped:
        sections.append(Section("Left out", _left_out(collection.skipped)))
    write_page(
        folder / "index.html",
        f"Evaluation on {TITLES.get(collection.data, collection.data)}",
        lead_text(collection, [method.name for method in methods]),
        sections,
    )


def lead_text(collection: Collection, names: Sequence[str]) -> str:
    """What was measured, as counted, in a sentence or two."""
    left_out = len(collection.skipped)
    more = f" {left_out} files or captures could not be used." if left_out else ""
    return (
        f"{_number(len(names), 'method')} on {_number(len(collection.shots), 'photograph')} of "
        f"{_number(len(collection.subjects), 'subject')}. {collection.truth}{more}"
    )


def _number(count: int, what: str) -> str:
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def _notes(collection: Collection, found: Sequence[MethodErrors]) -> list[Block]:
    lit = [e for e in found[0].images if e.shot.light]
    _, alone = light_classification(lit) if lit else ([], [])
    if not alone:
        return []
    return [
        f"Left out of the classification, because only one subject was seen under them: {', '.join(alone)}."
    ]


def _by_group(data: str, names: Sequence[str], records: Sequence[Record]) -> list[Block]:
    values = {record.what: record.value for record in records}

    def lines(keys: Sequence[str]) -> dict[str, list[float | None]]:
        return merge_equal_methods(
            {
                name: [
                    values.get(f"{dotted_word(data)}.{dotted_word(name)}.normals.{key}.mean_deg")
                    for key in keys
                ]
                for name in names
            }
        )

    bins = [(f"{low} to {min(high, 180)}", bin_name(low, high)) for low, high in BINS]
    regions = [(name, region_name(name)) for name in REGIONS]
    found: list[Block] = []
    for groups, label, caption in (
        (regions, "", "Mean error of normals by the region of the face."),
        (
            bins,
            "angle of the light from the viewer's direction (degrees)",
            "The same by the angle of the light.",
        ),
    ):
        drawn = lines([key for _, key in groups])
        if any(value is not None for row in drawn.values() for value in row):
            png = lines_by_group(
                [g for g, _ in groups], drawn, label="error of normals (degrees)", groups_label=label
            )
            found.append(Figure(png, caption))
    return found


def merge_equal_methods(lines: Mapping[str, list[float | None]]) -> dict[str, list[float | None]]:
    """Lines by name, those that lie on each other under all their names: methods may share their normals."""
    names: dict[tuple[float | None, ...], list[str]] = {}
    for name, values in lines.items():
        names.setdefault(tuple(values), []).append(name)
    return {", ".join(shared): list(values) for values, shared in names.items()}


def _pictures(
    collection: Collection, methods: Sequence[Method], method: Method, measured: MethodErrors
) -> list[Section]:
    shots = collection.shots
    sections = [
        Section(
            "Side by side",
            [
                Figure(
                    side_by_side(methods, first_samples(shots)),
                    "Photographs, what is known of them, and each method's normals (with its name), albedo "
                    "and reconstruction (left out where it is the photograph by construction).",
                )
            ],
        ),
        Section(
            "Taken apart and relit",
            [
                Figure(
                    decomposition_rows(method, samples_for_decomposition(shots)),
                    f"{method.name}: shading, albedo and relit views are each as bright as fits the picture.",
                )
            ],
        ),
    ]
    pairs = samples_for_transfer(measured.images)
    if pairs:
        sections.append(
            Section(
                "Light transfer",
                [
                    Figure(
                        light_transfer_rows(method, pairs),
                        f"{method.name}: two people exchange their lights: opposite sides, harsh against "
                        "frontal, from above against from the side. Order-2 light casts no shadows.",
                    )
                ],
            )
        )
    extreme = find_extremes(measured.images)
    if extreme is not None:
        sections.append(Section("Best and worst", _extremes(method, measured, extreme)))
    return sections


def _extremes(method: Method, measured: MethodErrors, found: Extremes) -> list[Block]:
    share = f"{100 * SHARE:.0f} %"
    what = "of normals" if found.unit == "deg" else "of the reconstruction (RMSE)"
    blocks: list[Block] = [
        Figure(
            rank_samples(
                method, example_rows(part, _EXAMPLES), found.unit, found.causes if word == "worst" else ()
            ),
            f"{method.name}: examples out of the {word} {share} by the error {what}"
            + (
                ". Below the last picture: what is furthest from its mean over all photographs, on the side "
                "where errors grow, weighted with how much they do."
                if word == "worst"
                else "."
            ),
        )
        for word, part in (("best", found.best), ("worst", found.worst))
    ]
    rows = [
        [c.name, *(f"{value:.1f}" for value in (c.best, c.all, c.worst)), _rank(c.rank)] for c in found.causes
    ]
    if rows:
        headers = ["measured cause (% of skin)", f"best {share}", "all", f"worst {share}", "rank correlation"]
        caption = (
            "What the worst photographs have more of than the best. The last column is Spearman's rank "
            "correlation with the error over all photographs: 1 if the error always grows with the cause. "
            "What covers a face, such as hair and glasses, is not measured."
        )
        blocks.append(Table(headers, rows, caption))
    return blocks


def _rank(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.2f}"


def _left_out(skipped: Mapping[str, str]) -> list[Block]:
    rows = [[name, why] for name, why in list(skipped.items())[:_SHOWN]]
    rest = len(skipped) - len(rows)
    caption = f"The first {len(rows)}; {rest} more are counted in the records." if rest else ""
    return [Table(["file or capture", "reason"], rows, caption)]
