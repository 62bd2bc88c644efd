"""Freed memory that is kept costs no page faults when it is allocated again."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

#: Prints the page faults of filling 32 MiB for the tenth time, each time in a fresh block. NumPy's blocks are
#: the C library's; `MADV_HUGEPAGE`, which NumPy asks for, would hide most faults.
ASK = """
import os, resource, sys
os.environ["NUMPY_MADVISE_HUGEPAGE"] = "0"
import numpy as np
from sfsnet_dr.core.host import keep_freed_memory
if sys.argv[1] == "keep":
    assert keep_freed_memory()
for _ in range(10):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    block = np.ones(32 * 2**20, np.uint8)
    del block
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(how: str) -> int:
    """Page faults of the tenth filling, in a process of its own."""
    done = subprocess.run([sys.executable, "-c", ASK, how], capture_output=True, text=True, check=True)
    return int(done.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc can be told to keep freed memory")
def test_a_block_that_was_freed_is_used_again_without_faults() -> None:
    # 32 MiB are 8192 pages of 4 KiB, 16 of 2 MiB where the system makes huge pages of its own accord
    assert faults("keep") <= 4
    assert faults("give") >= 16
