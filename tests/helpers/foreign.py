"""Installs the package of somebody else's renderers where only one test finds it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PACKAGE = Path(__file__).parent / "foreign_renderer"


def install(target: Path) -> Path:
    """Build and install it into a folder, without a network; the folder has to be put on ``sys.path``."""
    source = target / "source"
    source.mkdir(parents=True)
    for path in PACKAGE.iterdir():
        if path.is_file():
            (source / path.name).write_bytes(path.read_bytes())  # building leaves files beside the source
    packages = target / "packages"
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "--no-index", "--target", str(packages), str(source)], check=True)
    return packages
