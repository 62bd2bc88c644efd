"""Evaluate all methods on one collection of photographs, or on everything that a folder holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import output_dir, write_text
from sfsnet_dr.data.databases.registry import recognise_database
from sfsnet_dr.experiments.evaluation.collect import KINDS, Amount, collect_samples
from sfsnet_dr.experiments.evaluation.measure import measure_methods
from sfsnet_dr.experiments.evaluation.methods import RequestedMethod, methods_for
from sfsnet_dr.experiments.evaluation.page import TITLES, lead_text, write_pages
from sfsnet_dr.experiments.evaluation.records import (
    csv_text,
    evaluation_records,
    result_tables,
    sample_counts,
)
from sfsnet_dr.experiments.evaluation.samples import Collection
from sfsnet_dr.experiments.evaluation.splits import cross_validated, is_heldout, unseen_subjects
from sfsnet_dr.inference.methods import Method
from sfsnet_dr.models.shipped import SHIPPED, weights_path
from sfsnet_dr.report.console import progress_bar
from sfsnet_dr.report.html import Block, Link, Section, write_page
from sfsnet_dr.report.record import Record, write_records


def evaluate(
    collection: Collection, methods: Sequence[Method], out: Path | str, command: str
) -> list[Record]:
    """Measure methods and write ``records.json``, ``table.csv`` and ``index.html``.

    Args:
        collection: the photographs; a network that was fine-tuned on some of the subjects is measured on
            the others only.
        methods: with different names.
        out: folder, made if missing.
        command: for the records.
    """
    folder = output_dir(out)
    records = sample_counts(collection, command)
    theirs = {method.name: unseen_subjects([method], collection) for method in methods}
    found, names = [], []
    with progress_bar("measuring", sum(len(part.shots) for part in theirs.values())) as advance:
        for method in methods:
            names.append(method.name)

            def on_batch(count: int) -> None:
                for _ in range(count):
                    advance()

            found.append(measure_methods(method, theirs[method.name].shots, on_batch))
            records += evaluation_records(theirs[method.name], found[-1], command)
            apart = is_heldout(method, found[-1])
            if apart is not None:
                records += evaluation_records(collection, apart, command)
                names.append(apart.method)
    for whole in cross_validated(methods, found):
        records += evaluation_records(collection, whole, command)
        names.append(whole.method)
    write_records(folder / "records.json", records)
    write_text(folder / "table.csv", csv_text(collection.data, names, records))
    write_pages(folder, collection, methods, names, found, records)
    return records


#: What `all` looks for, in this order; ``lights`` are in yale-b's own numbers.
_ORDER: Final = ("yale-b", "photoface", "labels", "celeba", "folder", "synthetic")

#: Compact file of ICT FaceKit, which the 3DMM fits where the folder has it.
FACE_MODEL: Final = "ict_facekit.npz"


def find_data(folder: Path, faces: Sequence[Path] = ()) -> list[tuple[str, list[Path]]]:
    """Kinds of data in a folder or right below it, with their folders; rendered faces are taken together.

    Raises:
        InputError: if there is none, or two of a kind.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; a folder of face data is needed")
    found: dict[str, list[Path]] = {"synthetic": list(faces)}
    parts = sorted(path for path in folder.iterdir() if path.is_dir())
    own = recognise_database(folder)
    if own == "folder" and {recognise_database(part) for part in parts} - {None, "folder"}:
        own = None  # photographs beside other data, and no folder of folders of photographs
    for place in parts if own is None else [folder]:
        kind = recognise_database(place)
        if kind in _ORDER:
            found.setdefault(kind, []).append(place)
    for kind, several in found.items():
        if len(several) > 1 and kind != "synthetic":
            raise InputError(f"{folder}: {several[0].name} and {several[1].name} both look like {kind}; "
                           "evaluate each alone")  # fmt: skip
    chosen = [(kind, found[kind]) for kind in _ORDER if found.get(kind)]
    if not chosen:
        known = ", ".join(KINDS)
        raise InputError(f"{folder}: none of {known} found in it; see `sfsnet-dr data check --help`")
    return chosen


def evaluate_all(
    folder: Path, faces: Sequence[Path], wanted: RequestedMethod, out: Path, amount: Amount, command: str
) -> tuple[list[Record], dict[str, str]]:
    """Evaluate each kind of data into a folder of its name, and write a page and the records of all.

    Args:
        folder: see ``find_data``.
        faces: folders of rendered faces that lie elsewhere.
        wanted: the methods; the networks that come with the package where it names no weights, the folder's
            own ``FACE_MODEL`` where it names none.
        out: folder, made if missing.
        amount: how much of the data.
        command: for the records.

    Returns:
        All records, and why baselines are missing, by kind of data and name.
    """
    data = find_data(folder, faces)
    if not wanted.weights:
        shipped = tuple(Path(name) for name in SHIPPED if weights_path(name).is_file())
        wanted = replace(wanted, weights=shipped)
    if wanted.model_path is None and (folder / FACE_MODEL).is_file():
        wanted = replace(wanted, model_path=folder / FACE_MODEL)
    target = output_dir(out)
    records: list[Record] = []
    left_out: dict[str, str] = {}
    sections = []
    for kind, folders in data:
        collection = collect_samples(kind, folders, amount)
        methods, missing = methods_for(collection.shots, wanted, collection.listing)
        left_out |= {f"{kind}: {name}": reason for name, reason in missing.items()}
        own = evaluate(collection, methods, target / kind, command)
        names = [method.name for method in methods]
        blocks: list[Block] = [lead_text(collection, names), *result_tables(collection.data, names, own)]
        link = Link(f"{kind}/index.html", f"All of {kind}: figures, pictures, what was left out")
        sections.append(Section(f"On {TITLES.get(collection.data, kind)}", [*blocks, link]))
        records += own
    write_records(target / "records.json", records)
    lead = "The same methods on all data at hand. Every number with its interval is in `records.json`."
    write_page(target / "index.html", "Evaluation", lead, sections)
    return records, left_out
