"""What a wheel holds, and that the pinned versions fit what the project asks for."""

from __future__ import annotations

import configparser
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """A wheel built from a copy, so that the checkout stays clean; no network is needed."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "README.md", "LICENSE", "NOTICE"):
        shutil.copy(ROOT / name, source)
    for name in ("sfsnet_dr", "scenes", "training", "eval", "tests"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    code = f"from setuptools import build_meta; build_meta.build_wheel({str(out)!r})"
    subprocess.run([sys.executable, "-c", code], cwd=source, check=True, capture_output=True)
    [path] = out.iterdir()
    return zipfile.ZipFile(path)


def test_every_source_file_is_in_the_wheel_and_nothing_else(wheel: zipfile.ZipFile) -> None:
    packed = {name for name in wheel.namelist() if ".dist-info/" not in name and ".data/" not in name}
    ours = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "sfsnet_dr").rglob("*")
        if path.suffix in {".py", ".pyi", ".html", ".toml", ".json", ".md", ".safetensors", ".npz"}
        or path.name == "py.typed"
    }
    assert packed == ours
    assert "sfsnet_dr/report/templates/page.html" in packed


@pytest.mark.parametrize("how", ["--prefix", "--target"])
def test_the_wheel_brings_the_validation_scenes_and_finds_them_once_installed(
    wheel: zipfile.ZipFile, tmp_path: Path, how: str
) -> None:
    packed = {Path(name).name for name in wheel.namelist() if "/scenes/validation/" in name}
    assert packed == {path.name for path in (ROOT / "scenes" / "validation").iterdir()}
    assert wheel.filename is not None
    site = tmp_path / "site"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--ignore-installed"]
    subprocess.run([*pip, how, str(site), wheel.filename], check=True, capture_output=True)
    [package] = site.rglob("sfsnet_dr/__init__.py")
    code = "from sfsnet_dr.scene.subject import find_scene; print(find_scene('bowl'))"
    environment = os.environ | {"PYTHONPATH": str(package.parents[1])}
    found = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert found.returncode == 0, found.stderr
    path = Path(found.stdout.strip())
    assert path.is_relative_to(site)
    assert path.is_file()


def test_the_wheel_has_the_command_and_the_licences(wheel: zipfile.ZipFile) -> None:
    names = {name.split(".dist-info/", 1)[1]: name for name in wheel.namelist() if ".dist-info/" in name}
    scripts = configparser.ConfigParser()
    scripts.read_string(wheel.read(names["entry_points.txt"]).decode())
    assert scripts["console_scripts"]["sfsnet-dr"] == "sfsnet_dr.cli.main:main"
    assert {"licenses/LICENSE", "licenses/NOTICE"} <= set(names)


def test_the_version_is_the_packages() -> None:
    import sfsnet_dr

    assert sfsnet_dr.__version__ == PROJECT["version"]


#: Pulled in on one platform only.
ONLY_LINUX = {"karellen-llvm-core", "wheel-axle-runtime"}

#: pip comes with the environment. torch's default build on Linux also needs CUDA libraries, which it pins.
NOT_OURS = {"wheel-axle-runtime": {"pip"}}


def constraints() -> dict[str, Version]:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][0-9A-Za-z.]*", pin) for pin in pins), pins
    return {canonicalize_name(name): Version(version) for name, version in (p.split("==") for p in pins)}


def required(name: str, extras: frozenset[str]) -> list[Requirement]:
    found = [Requirement(text) for text in metadata.requires(name) or []]
    return [
        r for r in found if r.marker is None or any(r.marker.evaluate({"extra": e}) for e in extras | {""})
    ]


def test_every_package_that_an_install_pulls_in_is_pinned_to_a_version_that_fits() -> None:
    pins, waiting, seen = constraints(), [("sfsnet_dr", frozenset({"dev"}))], set()
    while waiting:
        name, extras = waiting.pop()
        for requirement in required(name, extras):
            key = canonicalize_name(requirement.name)
            if key in NOT_OURS.get(name, ()) or (name == "torch" and key not in pins):
                continue
            assert key in pins, f"{key}, which {name} needs, has no line in constraints.txt"
            assert requirement.specifier.contains(pins[key]), f"{key} {pins[key]} against {requirement}"
            if key not in seen:
                seen.add(key)
                waiting.append((key, frozenset(requirement.extras)))
    assert pins.keys() - seen - ONLY_LINUX == set(), "constraints.txt pins what nothing needs"


def test_torch_is_pinned_and_drjit_is_left_to_mitsuba() -> None:
    assert constraints()["torch"] == Version("2.13.0")
    asked = {canonicalize_name(Requirement(text).name) for text in PROJECT["dependencies"]}
    assert "mitsuba" in asked
    assert "drjit" not in asked
