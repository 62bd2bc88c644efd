"""Small data that several modules of tests learn from."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def surfaces(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Captures of six people, with exact labels."""
    from helpers.captures import write_faces

    return write_faces(tmp_path_factory.mktemp("labels") / "a")


@pytest.fixture(scope="module")
def spheres(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three rendered spheres of 16 x 16."""
    from helpers.spheres import write_spheres

    return write_spheres(tmp_path_factory.mktemp("faces"), 3)
