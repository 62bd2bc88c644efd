"""``history.jsonl``: what every training step gave, one line each."""

from __future__ import annotations

import json
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from sfsnet_dr.base import atomic
from sfsnet_dr.base.checks import BadInput


class History:
    """The history of one run; each line is on disk when ``add`` returns.

    Args:
        path: the file.
        first_step: the step that comes next. Lines of it and of later steps, which a run that was cut off
            after its last checkpoint may have left, are removed; so is everything at step 0.
    """

    def __init__(self, path: Path, first_step: int) -> None:
        kept = [line for line in read_history(path) if line["step"] < first_step] if path.exists() else []
        atomic.write_text(path, "".join(json.dumps(line) + "\n" for line in kept))
        self._file = path.open("a", encoding="utf-8")

    def add(self, **values: Any) -> None:
        """Append a line."""
        self._file.write(json.dumps(values) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def read_history(path: Path | str) -> list[dict[str, Any]]:
    """All whole lines of a history: step, rate, total, recon, normal, albedo, light, images_per_second.

    A skipped step has ``skipped`` (the reason) instead of the losses. A last line without its end, as a crash
    leaves it, is left out.

    Raises:
        BadInput: if the file is missing or a whole line is no JSON.
    """
    path = Path(path)
    if not path.is_file():
        raise BadInput(f"{path}: no such file; `sfsnet-dr train` writes it")
    text = path.read_text(encoding="utf-8")
    try:
        return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]
    except ValueError as error:
        raise BadInput(f"{path}: not a training history ({error})") from error
