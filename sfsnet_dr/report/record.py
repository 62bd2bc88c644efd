"""Records: one schema for every measured number; tables, figures and pages only read them."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from markupsafe import escape

from sfsnet_dr.core import files
from sfsnet_dr.core.errors import InputError, RunError, nearest
from sfsnet_dr.report.html import Section, Table

#: What ``what`` looks like: lower-case words joined by dots, from the general to the particular.
_DOTTED = re.compile(r"[a-z0-9][a-z0-9_-]*(\.[a-z0-9][a-z0-9_-]*)+")


@dataclass(frozen=True)
class Record:
    """One measured number and what is needed to judge or repeat it.

    Attributes:
        what: dotted name, such as ``validate.order2.sphere.rel_rmse``.
        value: the finite number itself.
        unit: its unit in plain text; ``"1"`` for a ratio.
        interval: lower and upper end of a 95 % interval around ``value``, or None where none was taken.
        command: the command that measured it.
        versions: package name -> version.
        machine: processor, cores, memory; never a host name.
        seed: the seed of the random numbers used, or None where none were.

    Raises:
        RunError: if a number is not finite or a field has another type; such a result must not be stored.
    """

    what: str
    value: float
    unit: str
    interval: tuple[float, float] | None = None
    command: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    machine: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None

    def __post_init__(self) -> None:
        problem = _problem(asdict(self))
        if problem:
            raise RunError(f"record {self.what!r}: {problem}")

    def _repr_html_(self) -> str:
        """One row of a table, for notebooks."""
        ends = "" if self.interval is None else f"{self.interval[0]:.4g} to {self.interval[1]:.4g}"
        cells = (self.what, f"{self.value:.4g}", ends, self.unit)
        return "<table><tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr></table>"


def make_record(
    what: str,
    value: float,
    unit: str,
    *,
    command: str,
    interval: tuple[float, float] | None = None,
    seed: int | None = None,
) -> Record:
    """A record with the versions and the machine of this process filled in."""
    from sfsnet_dr.core import provenance

    ends = None if interval is None else (float(interval[0]), float(interval[1]))
    return Record(
        what=what,
        value=float(value),
        unit=unit,
        interval=ends,
        command=command,
        versions=provenance.versions(),
        machine=provenance.machine(),
        seed=seed,
    )


def dotted_word(name: str) -> str:
    """A name from outside, such as a file's, as one word of ``what``."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "unnamed"


def to_json(records: Iterable[Record]) -> str:
    """A JSON array of the records, one object a record."""
    return json.dumps([asdict(r) for r in records], indent=2, allow_nan=False)


def write_records(path: Path | str, records: Iterable[Record]) -> None:
    """Write a JSON array of records as a whole file."""
    files.write_text(path, to_json(records) + "\n")


def read_records(path: Path | str) -> list[Record]:
    """Read what ``write_records`` wrote.

    Raises:
        InputError: naming the file, the record, the field, what was found and what is allowed.
    """
    path = Path(path)
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; a JSON array of records is needed") from error
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: not readable as JSON ({error}); a JSON array of records is needed"
        ) from error
    if not isinstance(rows, list):
        raise InputError(f"{path}: a JSON {type(rows).__name__} found, an array of records is needed")
    for position, row in enumerate(rows):
        problem = _problem(row)
        if problem:
            raise InputError(f"{path}: record {position}: {problem}")
    return [Record(**(row | {"interval": _pair(row["interval"])})) for row in rows]


def _pair(interval: list[float] | None) -> tuple[float, float] | None:
    return None if interval is None else (interval[0], interval[1])


def _problem(row: object) -> str | None:
    """The first way in which a row departs from the schema, or None."""
    if not isinstance(row, dict):
        return f"{type(row).__name__} found, an object is needed"
    names = [f.name for f in fields(Record)]
    for key in row:
        if key not in names:
            return f"unknown field {key!r}; {nearest(str(key), names)}"
    for name in names:
        if name not in row:
            return f"field {name!r} is missing; needed: {', '.join(names)}"
        if not _VALID[name](row[name]):
            return f"{name} = {row[name]!r} found, {_ALLOWED[name]} is allowed"
    return None


def _finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_interval(value: object) -> bool:
    if value is None:
        return True
    if not isinstance(value, list | tuple) or len(value) != 2 or not all(_finite(v) for v in value):
        return False
    return bool(value[0] <= value[1])


_VALID: dict[str, Callable[[Any], bool]] = {
    "what": lambda v: isinstance(v, str) and _DOTTED.fullmatch(v) is not None,
    "value": _finite,
    "unit": lambda v: isinstance(v, str) and v != "",
    "interval": _is_interval,
    "command": lambda v: isinstance(v, str),
    "versions": lambda v: isinstance(v, Mapping) and all(isinstance(x, str) for x in v.values()),
    "machine": lambda v: isinstance(v, Mapping),
    "seed": lambda v: v is None or (isinstance(v, int) and not isinstance(v, bool)),
}
_ALLOWED = {
    "what": "a lower-case dotted name such as 'demo.seconds'",
    "value": "a finite number",
    "unit": "a non-empty text ('1' for a ratio)",
    "interval": "null or two finite numbers, the lower first",
    "command": "a text",
    "versions": "an object of texts",
    "machine": "an object",
    "seed": "null or a whole number",
}


def all_numbers(records: Sequence[Record], over: str) -> Section:
    """A section with each record's value, 95 % interval and unit.

    Args:
        records: what ``records.json`` beside the page holds.
        over: what the intervals are over, "images" say.
    """
    rows = [
        [
            record.what,
            f"{record.value:.4g}",
            "" if record.interval is None else f"{record.interval[0]:.4g} to {record.interval[1]:.4g}",
            record.unit,
        ]
        for record in records
    ]
    caption = f"The same as in `records.json`, with 95 % intervals over {over}."
    return Section("All numbers", [Table(["what", "value", "interval", "unit"], rows, caption)])
