"""Files and folders that are either whole or absent."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sfsnet_dr.core.errors import InputError


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Give a temporary name beside ``path``; rename it to ``path`` if the block ends well.

    The temporary name keeps the suffix, because image libraries choose the format by it.

    Raises:
        InputError: if the folder is missing or cannot be written to.
    """
    path = Path(path)
    try:
        handle, name = tempfile.mkstemp(prefix=".partial-", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose a writable folder") from error
    os.close(handle)
    partial = Path(name)
    try:
        yield partial
        partial.chmod(0o666 & ~_umask())
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def write_text(path: Path | str, text: str) -> None:
    """Write a UTF-8 text file as a whole."""
    with atomic_path(path) as partial:
        partial.write_text(text, encoding="utf-8")


def output_dir(path: Path | str) -> Path:
    """Create a folder for output and prove that it can be written to.

    Raises:
        InputError: if it is a file, or cannot be made or written to.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file, a folder is needed for the output")
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose a writable folder") from error
    return path


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
