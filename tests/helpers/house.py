"""Measures the code itself for ``eval/results/house.json``: python tests/helpers/house.py [INSTALL_MB]"""

from __future__ import annotations

import statistics
import subprocess
import sys
from pathlib import Path

import sfsnet_dr as sf
from sfsnet_dr.experiments.demo.run import import_seconds
from sfsnet_dr.report.record import Record, make_record, write_records

ROOT = Path(__file__).parents[2]


def lines_of_modules() -> list[int]:
    """Lines of every module of the package that holds code."""
    files = [path for path in (ROOT / "sfsnet_dr").rglob("*.py") if path.name != "__init__.py"]
    return [len(path.read_text(encoding="utf-8").splitlines()) for path in files]


def house_records(install_mb: float | None = None) -> list[Record]:
    """Return the records ``house.*``, ``api.*``, ``readme.words``, ``import.seconds`` and ``install.mb``."""
    lines = lines_of_modules()
    documented = sum("Example:" in (getattr(sf, name).__doc__ or "") for name in sf.__all__)
    cycles = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "tests/test_imports.py", "-k", "imports_itself"],
        cwd=ROOT,
        capture_output=True,
        check=False,
    )
    numbers: dict[str, tuple[float, str]] = {
        "house.modules": (len(lines), "modules"),
        "house.lines": (sum(lines), "lines"),
        "house.median_lines": (statistics.median(lines), "lines"),
        "house.cycles": (float(cycles.returncode != 0), "cycles"),
        "api.names": (len(sf.__all__), "names"),
        "api.documented": (documented, "names with an example"),
        "readme.words": (len((ROOT / "README.md").read_text(encoding="utf-8").split()), "words"),
        "import.seconds": (import_seconds(), "s"),
    }
    if install_mb is not None:
        numbers["install.mb"] = (install_mb, "MB")
    return [
        make_record(what, *each, command="python tests/helpers/house.py") for what, each in numbers.items()
    ]


if __name__ == "__main__":
    found = house_records(float(sys.argv[1]) if len(sys.argv) > 1 else None)
    write_records(ROOT / "eval" / "results" / "house.json", found)
    for record in found:
        print(f"{record.what}: {record.value:g} {record.unit}")
