"""The process and its host: memory that the allocator keeps, and a standard output kept for results.

glibc maps every large block anew and gives it back when it is freed. A training step allocates hundreds of
them, and the system clears each page of each again: a tenth of a step of SfSNet on two cores (`bench train`).
"""

from __future__ import annotations

import ctypes
import os
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Final

#: Parameters of ``mallopt``, from glibc's malloc.h.
_TRIM_THRESHOLD: Final = -1
_MMAP_MAX: Final = -4


def keep_freed_memory() -> bool:
    """Keep what is freed for what is allocated next, up to the most that this process ever needed at once.

    Blocks that were allocated before stay as they are. It holds until the process ends; call it where one
    does the same work many times over.

    Returns:
        Whether the C library could be told; only glibc can.
    """
    if platform.libc_ver()[0] != "glibc":
        return False
    library = ctypes.CDLL(None)
    asked = [library.mallopt(_MMAP_MAX, 0), library.mallopt(_TRIM_THRESHOLD, -1)]
    return all(asked)


@contextmanager
def standard_output_to_error() -> Iterator[None]:
    """Send what this process prints, compiled libraries included, to standard error."""
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
