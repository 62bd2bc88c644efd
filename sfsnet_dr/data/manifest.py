"""``manifest.jsonl``: the list of a dataset's bundles, one line each, which a crash cannot spoil."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Final

from sfsnet_dr.core.errors import InputError

NAME: Final = "manifest.jsonl"


@dataclass(frozen=True)
class Entry:
    """One bundle of a dataset.

    Args:
        file: name inside the dataset's folder.
        seed: the seed that gives it again.
        face_model: name of the face model.
        spec_hash: hash of the specification; the same for the whole dataset.
        sha256: of the file's bytes.
        versions: of the software that made it.
    """

    file: str
    seed: int
    face_model: str
    spec_hash: str
    sha256: str
    versions: dict[str, str] = field(default_factory=dict)


class Manifest:
    """The manifest of one folder, read at once and appended to line by line.

    Only one process may append. A line that a crash cut short is not counted as an entry, and is removed
    before the next is written; a bundle file without an entry does not belong to the dataset.

    Args:
        folder: the dataset's folder; it may lack a manifest, which then is empty.
        spec_hash: if given, the specification that the dataset must be of.

    Raises:
        InputError: if a line is damaged, or lists a bundle of another specification.
    """

    def __init__(self, folder: Path | str, spec_hash: str | None = None) -> None:
        self.folder = Path(folder)
        self.path = self.folder / NAME
        text = self.path.read_bytes() if self.path.is_file() else b""
        self._whole = text.rfind(b"\n") + 1
        lines = text[: self._whole].decode("utf-8", errors="replace").splitlines()
        self.entries = [_parse(f"{self.path}:{number}", line) for number, line in enumerate(lines, 1)]
        self.spec_hash = spec_hash
        for entry in self.entries:
            self._check(entry)

    def append(self, entry: Entry) -> None:
        """Add a line once its bundle is in place.

        Raises:
            InputError: for another specification than the entries before, or a file already listed.
        """
        self._check(entry)
        if any(entry.file == other.file for other in self.entries):
            raise InputError(
                f"{self.path}: {entry.file} is already listed; remove it or choose another folder"
            )
        line = json.dumps(asdict(entry), sort_keys=True).encode() + b"\n"
        with self.path.open("r+b" if self.path.exists() else "xb") as file:
            file.truncate(self._whole)
            file.seek(self._whole)
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
        self._whole += len(line)
        self.entries.append(entry)

    def finished_seeds(self) -> set[int]:
        """Seeds whose bundles are listed and present: what a resumed run need not render again."""
        return {entry.seed for entry in self.entries if (self.folder / entry.file).is_file()}

    def _check(self, entry: Entry) -> None:
        self.spec_hash = self.spec_hash or entry.spec_hash
        if entry.spec_hash != self.spec_hash:
            raise InputError(
                f"{self.path}: holds bundles of specification {entry.spec_hash}, {self.spec_hash} expected; "
                "choose another folder"
            )


def _parse(where: str, line: str) -> Entry:
    try:
        values: dict[str, Any] = json.loads(line)
        known = {f.name for f in fields(Entry)}
        return Entry(**{key: value for key, value in values.items() if key in known})
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{where}: not a manifest line ({error}); render the dataset again") from error
