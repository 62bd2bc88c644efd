"""What commands show on a terminal: a bar while they work, records as lines when they are done."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from sfsnet_dr.report.record import Record


def record_lines(records: Sequence[Record]) -> list[str]:
    """One line a record: name, value, unit and interval, in columns."""
    width = max((len(record.what) for record in records), default=0)
    return [_line(record, width) for record in records]


@contextmanager
def progress_bar(what: str, total: int, done: int = 0) -> Iterator[Callable[[], None]]:
    """A progress bar on standard error with rate and time left; call what it gives once for each step."""
    what_column, rest = TextColumn("{task.description}"), (_Rate(), TimeRemainingColumn())
    with Progress(
        what_column, BarColumn(), MofNCompleteColumn(), *rest, console=Console(stderr=True)
    ) as progress:
        task = progress.add_task(what, total=total, completed=done)
        try:
            yield lambda: progress.advance(task)
        except BaseException:
            progress.live.transient = True  # the line that tells the failure stands alone, also in a log
            progress.console.quiet = not progress.console.is_interactive
            raise


class _Rate(ProgressColumn):
    """Steps a second, or seconds a step where that is the larger number; nothing before it is known."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        if not speed:
            return Text("")
        return Text(f"{speed:.1f}/s" if speed >= 1 else f"{1 / speed:.1f} s each")


def _line(record: Record, width: int) -> str:
    unit = "" if record.unit == "1" else f" {record.unit}"
    text = f"{record.what:<{width}}  {record.value:.4g}{unit}"
    if record.interval is None:
        return text
    return f"{text}  [{record.interval[0]:.4g}, {record.interval[1]:.4g}]"
