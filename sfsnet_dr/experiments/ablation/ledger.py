"""Processor time of each piece of work, kept in a file so that a resumed study still knows it."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sfsnet_dr.experiments.ablation.config import Plan


class CostLedger:
    """Processor seconds of this process, all threads together, by the name of the work.

    Time of a process that was killed before it could note it is lost.

    Args:
        path: a line of JSON for each piece of work; made when the first is noted.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._last = time.process_time()

    def start(self) -> None:
        """Forget the time since the last note: it belongs to nothing."""
        self._last = time.process_time()

    def note(self, what: str) -> None:
        """The time since ``start`` or the last note was spent on this."""
        now = time.process_time()
        line = json.dumps({"what": what, "seconds": round(now - self._last, 4)})
        with self.path.open("a", encoding="utf-8") as file:
            file.write(line + "\n")
        self._last = now

    @contextmanager
    def spent(self, what: str) -> Iterator[None]:
        """Note the time of a block, also of one that fails."""
        self.start()
        try:
            yield
        finally:
            self.note(what)

    def seconds(self, what: str) -> list[float]:
        """All that was noted for a piece of work, in order."""
        if not self.path.is_file():
            return []
        text = self.path.read_text(encoding="utf-8")
        lines = [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]
        return [float(line["seconds"]) for line in lines if line["what"] == what]


def rendering_entry(plan: Plan, folder: Path) -> str:
    """How the ledger calls the rendering of faces."""
    return f"rendering {folder.relative_to(plan.folder).as_posix()}"


def training_entry(name: str, seed: int) -> str:
    """How the ledger calls a training."""
    return f"training {name}-{seed}"


def labelling_entry(name: str, seed: int) -> str:
    """How the ledger calls the labelling of photographs."""
    return f"labelling {name}-{seed}"
