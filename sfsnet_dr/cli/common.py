"""What all commands share: how a result is given, the arguments that several have."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Protocol

from tyro.conf import arg

if TYPE_CHECKING:
    from sfsnet_dr.report.record import Record

Json = Annotated[
    bool, arg(name="json", help="Print a JSON array of records on standard output, nothing else.")
]
Out = Annotated[Path, arg(metavar="DIR", help="Folder for the results; made if it is missing.")]
FaceFolders = Annotated[
    tuple[Path, ...], arg(metavar="DIR", help="Folders that `sfsnet-dr synth` wrote, one or more.")
]


@dataclass(frozen=True)
class Result:
    """What a command has to say: lines to read, JSON for machines, and its exit code."""

    text: str
    json: str
    code: int = 0


class Command(Protocol):
    """A dataclass of a command's arguments that runs it."""

    @property
    def as_json(self) -> bool:
        """Whether standard output holds JSON alone."""

    def run(self) -> Result:
        """Do the work; heavy imports stand in here."""


def command_line() -> str:
    """The command as typed, for records."""
    return shlex.join(["sfsnet-dr", *sys.argv[1:]])


def result_of_records(records: Sequence[Record], *more: str) -> Result:
    """Records as JSON, or as lines to read with more lines after them."""
    from sfsnet_dr.report.console import record_lines
    from sfsnet_dr.report.record import to_json

    return Result(text="\n".join([*record_lines(records), *more]), json=to_json(records))
