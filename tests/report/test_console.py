"""What a terminal shows: records in columns, and a bar that leaves a failure's one line alone."""

from __future__ import annotations

import pytest

from sfsnet_dr.report.console import progress_bar, record_lines
from sfsnet_dr.report.record import Record


def test_records_are_lines_in_columns() -> None:
    records = [
        Record(what="demo.seconds", value=612.34, unit="s"),
        Record(what="validate.order2.sphere.rel_rmse", value=0.01234, unit="1", interval=(0.012, 0.0127)),
    ]
    assert record_lines(records) == [
        "demo.seconds                     612.3 s",
        "validate.order2.sphere.rel_rmse  0.01234  [0.012, 0.0127]",
    ]
    assert record_lines([]) == []


def test_the_bar_counts_on_standard_error(capfd: pytest.CaptureFixture[str]) -> None:
    with progress_bar("rendering faces", 3) as advance:
        advance()
        advance()
    told = capfd.readouterr()
    assert told.out == ""
    assert "rendering faces" in told.err
    assert "2/3" in told.err


def test_a_failure_under_the_bar_leaves_no_line_in_a_log(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(RuntimeError), progress_bar("rendering faces", 3):
        raise RuntimeError
    assert capfd.readouterr().err == ""
