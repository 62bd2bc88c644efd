"""What a result belongs to: versions, machine, hashes. Nothing here names a host, a user or a path."""

from __future__ import annotations

import hashlib
import os
import platform
import re
from collections.abc import Iterable
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Final

#: Distributions whose versions can change a result.
PACKAGES: Final = (
    "sfsnet_dr",
    "numpy",
    "scipy",
    "torch",
    "mitsuba",
    "drjit",
    "karellen-llvm-core",
    "OpenImageIO",
    "colour-science",
    "safetensors",
)


def versions(packages: Iterable[str] = PACKAGES) -> dict[str, str]:
    """Versions of Python and of the packages that are installed; those that are not have no entry."""
    found = {"python": platform.python_version()}
    each = {package: _version(package) for package in packages}
    return found | {package: version for package, version in each.items() if version is not None}


@cache
def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def machine() -> dict[str, str | int | float]:
    """System, architecture, processor, cores this process may use, memory in GiB where it is known."""
    facts: dict[str, str | int | float] = {
        "system": platform.system(),
        "architecture": platform.machine(),
        "cpu": _cpu_model(),
        "cores": _cores(),
    }
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        facts["memory_gib"] = round(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30, 1)
    return facts


def sha256(data: Path | bytes) -> str:
    """Hexadecimal SHA-256 of some bytes, or of a file's content."""
    if isinstance(data, bytes):
        return hashlib.sha256(data).hexdigest()
    with data.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _cpu_model() -> str:
    try:
        found = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    except OSError:
        found = None
    return found[1].strip() if found else platform.processor() or "unknown"


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
