"""The wheel in a clean environment, without the repository: commands that need no data run."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

COMMANDS = (
    "--version",
    "doctor",
    "weights list",
    "synth --out faces --count 1",
    "contact-sheet faces --out sheet --count 1",
    "relight faces/face-000000.exr --direction=-1,0.3,0.6 --out relit.png",
    "validate --scene sphere --lights natural0 --size 16 --samples 4 --renderers none --out validation",
)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the programs of an environment that holds the wheel and its dependencies alone."""
    folder = tmp_path_factory.mktemp("wheel")
    source, built, environment = folder / "source", folder / "built", folder / "environment"
    subprocess.run(["git", "clone", "-q", str(ROOT), str(source)], check=True)
    built.mkdir()
    code = f"from setuptools import build_meta; build_meta.build_wheel({str(built)!r})"
    subprocess.run([sys.executable, "-c", code], cwd=source, check=True, capture_output=True)
    venv.create(environment, with_pip=True)
    [wheel] = built.glob("*.whl")
    pip = [str(environment / "bin" / "python"), "-m", "pip", "install", "-q"]
    done = subprocess.run(
        [*pip, "-c", str(ROOT / "constraints.txt"), str(wheel)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        pytest.skip("the dependencies cannot be downloaded here")
    return environment / "bin"


@pytest.mark.slow
def test_commands_run_without_the_repository(installed: Path, tmp_path: Path) -> None:
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    for command in COMMANDS:
        done = subprocess.run(
            [installed / "sfsnet-dr", *command.split()],
            cwd=tmp_path,
            env=clean,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"


@pytest.mark.slow
def test_annys_package_and_what_it_needs_are_not_installed(installed: Path) -> None:
    names = ("anny", "warp", "roma", "trimesh")
    code = f"import importlib.util as u; print([name for name in {names} if u.find_spec(name)])"
    done = subprocess.run([installed / "python", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
