"""Numbers in the tables of README and docs are those of the stored records, rounded as written."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from sfsnet_dr.report.record import Record, read_records

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "eval" / "results"

#: Rows of the evaluation tables and the method in the records.
METHODS = {
    "flat normals": "flat",
    "leave-one-subject-out mean normals": "mean_face",
    "mean normals, constant albedo": "one_albedo",
    "mean normals, mean albedo": "mean_albedo",
    "3DMM, ICT FaceKit": "3dmm",
    "shape from shading (SIRFS-like)": "sirfs",
    "SfSNet-syn, rendered faces alone": "sfsnet_syn",
    "SkipNet, seen without labels": "skipnet",
    "SfSNet, seen without labels": "sfsnet",
    "SkipNet+, seen without labels": "skipnet_plus",
    "SkipNet, held-out weights, 4 unseen subjects": "skipnet_heldout_unseen",
    "SfSNet, held-out weights, 4 unseen subjects": "sfsnet_heldout_unseen",
    "SkipNet+, held-out weights, 4 unseen subjects": "skipnet_plus_heldout_unseen",
    "SkipNet-ft, the same 4 unseen subjects": "skipnet_ft_fold0of4",
    "SfSNet-ft, the same 4 unseen subjects": "sfsnet_ft_fold0of4",
    "SkipNet-ft, four folds, seen without labels": "skipnet_ft_seen_all4folds",
    "SfSNet-ft, the same four, seen without labels": "sfsnet_ft_seen_fold0of4",
}
COLUMNS = {
    "normals, degrees": "normals.mean_deg",
    "< 20, %": "normals.below20",
    "< 30, %": "normals.below30",
    "grazing light (> 77 deg)": "normals.angle77_180.mean_deg",
    "albedo, relative RMS": "albedo.scaled_rms",
    "high-confidence pixels": "albedo.confident.scaled_rms",
    "MAE": "recon.mae",
    "19 lights, top 1 %": "lights.top1",
    "64 lights": "lights64.top1",
    "images/s": "images_per_s",
}
#: Rows of README's table: the records of unseen subjects, and of those seen without labels.
README_ROWS = {
    "SkipNet": ("skipnet_heldout_unseen", "skipnet"),
    "SfSNet": ("sfsnet_heldout_unseen", "sfsnet"),
    "SkipNet+": ("skipnet_plus_heldout_unseen", "skipnet_plus"),
    "SfSNet on rendered faces alone": ("sfsnet_syn", None),
    "leave-one-subject-out mean normals, constant albedo": ("one_albedo", None),
    "3DMM fit": ("3dmm", None),
    "shape from shading (SIRFS-like)": ("sirfs", None),
}
#: Rows and columns of the validation table.
MODELS = {
    "order 0": "order0",
    "order 1": "order1",
    "order 2, the paper's": "order2",
    "order 4": "order4",
    "order 2 + visibility": "order2_visibility",
    "order 4 + visibility": "order4_visibility",
    "order 2 + one bounce": "order2_bounce",
    "order 4 + one bounce": "order4_bounce",
    "order 4 + bounce + gloss": "order4_gloss",
}
LIGHTS = {
    "head, natural light": "head",
    "head, one lamp at 60 degrees": "head.directional60",
    "glossy head, natural": "glossy_head",
    "glossy head, one lamp": "glossy_head.directional60",
}


@cache
def records(file: str) -> dict[str, Record]:
    return {record.what: record for record in read_records(RESULTS / file)}


def tables(page: str) -> list[list[list[str]]]:
    """Cells of every table of a page, the heading first."""
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = re.findall(r"(?:^\|.*\|$\n?)+", text, flags=re.MULTILINE)
    rows = (
        [[cell.strip() for cell in row.strip("|\n").split("|")] for row in b.splitlines()] for b in blocks
    )
    return [[row for row in table if not set("".join(row)) <= set("-: ")] for table in rows]


def with_heading(page: str, heading: str) -> list[list[list[str]]]:
    found = [table for table in tables(page) if heading in table[0]]
    assert found, f"{page}: no table with a column {heading!r}"
    return found


def check_cell(cell: str, record: Record, scale: float = 1.0) -> None:
    """A cell such as ``9.4 (8.5 to 10.1)`` is the record's value and interval, rounded to its digits."""
    numbers = re.findall(r"-?\d+(?:\.\d+)?", cell)
    expected = [record.value, *(record.interval or ())] if len(numbers) > 1 else [record.value]
    assert len(numbers) == len(expected), (cell, record)
    for written, value in zip(numbers, expected, strict=True):
        digits = len(written.partition(".")[2])
        unit = 10.0**-digits
        # Half a unit, and rounding half to even of a number that is stored in binary.
        assert abs(float(written) - scale * value) <= 0.5 * unit * (1 + 1e-6), (record.what, cell, value)


def check_evaluation(page: str) -> int:
    checked = 0
    for heading, *rows in with_heading(page, "grazing light (> 77 deg)"):
        for name, *cells in rows:
            for column, cell in zip(heading[1:], cells, strict=True):
                if re.search(r"\d", cell):
                    what = f"yale_b.{METHODS[name]}.{COLUMNS[column]}"
                    check_cell(cell, records("evaluate.json")[what])
                    checked += 1
    return checked


def test_the_evaluation_tables() -> None:
    assert check_evaluation("docs/evaluation.md") > 140


def test_the_results_of_the_readme() -> None:
    [[_, *rows]] = with_heading("README.md", "unseen: normals")
    assert {row[0] for row in rows} == set(README_ROWS)
    for name, normals, albedo, seen_normals, seen_albedo, seen_mae in rows:
        unseen, seen = README_ROWS[name]
        found = records("evaluate.json")
        check_cell(normals, found[f"yale_b.{unseen}.normals.mean_deg"])
        check_cell(albedo, found[f"yale_b.{unseen}.albedo.scaled_rms"])
        assert bool(seen) == bool(seen_normals)
        if seen:
            check_cell(seen_normals, found[f"yale_b.{seen}.normals.mean_deg"])
            check_cell(seen_albedo, found[f"yale_b.{seen}.albedo.scaled_rms"])
            check_cell(seen_mae, found[f"yale_b.{seen}.recon.mae"])


def test_the_errors_of_the_validation_table() -> None:
    [[heading, *rows]] = with_heading("docs/validation.md", "head, natural light")
    for name, *cells in rows:
        for column, cell in zip(heading[1:], cells, strict=True):
            if column in LIGHTS and re.search(r"\d", cell):
                what = f"validate.{MODELS[name]}.{LIGHTS[column]}.rel_rmse"
                check_cell(cell, records("validate.json")[what], 100.0)


def test_order_2_in_the_readme() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    found = re.search(r"on a head: (.*?)\s+of the\s+image under natural light, (.*?) under", text, re.DOTALL)
    assert found is not None
    for cell, light in zip(found.groups(), ("head", "head.directional60"), strict=True):
        check_cell(cell.replace(" %", ""), records("validate.json")[f"validate.order2.{light}.rel_rmse"], 100)


@pytest.mark.parametrize("change", [lambda v: v + 0.1, lambda v: -v])
def test_a_wrong_number_would_be_seen(change: Callable[[float], float]) -> None:
    record = records("evaluate.json")["yale_b.flat.normals.mean_deg"]
    check_cell(f"{record.value:.1f}", record)
    with pytest.raises(AssertionError):
        check_cell(f"{change(record.value):.1f}", record)
