"""Sphinx configuration: ``make docs``; no network is needed, and warnings are errors."""

from __future__ import annotations

import contextlib
import io
import os
from pathlib import Path

import sfsnet_dr
from sfsnet_dr.cli.commands import GROUPS
from sfsnet_dr.cli.help import overview
from sfsnet_dr.cli.main import main

project, author, copyright = "sfsnet_dr", "the sfsnet_dr authors", "the sfsnet_dr authors"
release = version = sfsnet_dr.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.doctest",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
html_theme = "furo"
html_title = f"sfsnet_dr {release}"
exclude_patterns = ["_build", "tutorials/*.py"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_custom_sections = [("Source", "notes_style")]
suppress_warnings = ["myst.xref_missing"]  # 2026-12-01: links to files of the repository beside docs/


def write_cli_reference(folder: Path) -> None:
    """Write cli.md from the help of every command, so that it is always current."""
    os.environ["COLUMNS"] = "100"
    os.environ["NO_COLOR"] = "1"
    parts = ["# Command line", "```text\n" + overview() + "\n```"]
    for title, group in GROUPS.items():
        parts.append(f"## {title}")
        for name in group:
            text = io.StringIO()
            with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
                main([*name.split(), "--help"])
            parts.append(f"### {name}\n\n```text\n{text.getvalue().strip()}\n```")
    (folder / "cli.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")


write_cli_reference(Path(__file__).parent)
