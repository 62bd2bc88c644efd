"""Records: the schema holds on writing and on reading."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from sfsnet_dr.core.errors import InputError, RunError
from sfsnet_dr.report.record import Record, read_records, to_json, write_records

GOOD = Record(
    what="validate.order2.sphere.rel_rmse",
    value=0.0123,
    unit="1",
    interval=(0.012, 0.0126),
    command="sfsnet-dr validate scenes/sphere.toml",
    versions={"mitsuba": "3.9.1"},
    machine={"cores": 2},
    seed=7,
)


def test_what_is_written_is_what_is_read(tmp_path: Path) -> None:
    records = [GOOD, Record(what="demo.seconds", value=600, unit="s")]
    write_records(tmp_path / "records.json", records)
    assert read_records(tmp_path / "records.json") == records


def test_the_json_is_an_array_with_the_fields_of_the_schema() -> None:
    [row] = json.loads(to_json([GOOD]))
    assert set(row) == {"what", "value", "unit", "interval", "command", "versions", "machine", "seed"}


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"value": float("nan")}, "value"),
        ({"value": float("inf")}, "value"),
        ({"value": True}, "value"),
        ({"what": "seconds"}, "what"),
        ({"what": "Demo.Seconds"}, "what"),
        ({"unit": ""}, "unit"),
        ({"interval": (2.0, 1.0)}, "interval"),
        ({"interval": (1.0,)}, "interval"),
        ({"seed": 1.5}, "seed"),
        ({"versions": {"numpy": 2}}, "versions"),
    ],
)
def test_a_wrong_field_is_refused_both_ways(tmp_path: Path, change: dict[str, object], named: str) -> None:
    row = asdict(GOOD) | change
    with pytest.raises(RunError, match=f"{named} = "):
        Record(**row)
    path = tmp_path / "records.json"
    path.write_text(json.dumps([row]), encoding="utf-8")
    with pytest.raises(InputError, match=rf"records\.json: record 0: {named} = .* found, .* allowed"):
        read_records(path)


def test_unknown_and_missing_fields_are_named(tmp_path: Path) -> None:
    path = tmp_path / "records.json"
    path.write_text(json.dumps([asdict(GOOD) | {"units": "s"}]), encoding="utf-8")
    with pytest.raises(InputError, match=r"unknown field 'units'; did you mean 'unit'\?"):
        read_records(path)
    row = asdict(GOOD)
    del row["command"]
    path.write_text(json.dumps([row]), encoding="utf-8")
    with pytest.raises(InputError, match="'command' is missing"):
        read_records(path)


@pytest.mark.parametrize("text", ["", "{}", "[1]", "not json"])
def test_other_files_are_refused_by_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"other\.json"):
        read_records(path)
    with pytest.raises(InputError, match="no such file"):
        read_records(tmp_path / "absent.json")
