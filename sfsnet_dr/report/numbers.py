"""Every record of a page as its last table."""

from __future__ import annotations

from collections.abc import Sequence

from sfsnet_dr.report.html import Section, Table
from sfsnet_dr.report.record import Record


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
