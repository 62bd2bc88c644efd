from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from sfsnet_dr.core import runtime
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.runtime import LLVM_COMMAND, LLVM_VARIABLE, find_llvm, llvm_version

#: Old libraries that this system happens to have; opening them is harmless, compiling with them is not.
OLD = [p for v in (14, 15) for p in Path("/usr/lib").glob(f"*-linux-gnu/libLLVM-{v}.so.1")]

LLVM_15 = [path for path in OLD if "15" in path.name]


@pytest.fixture(autouse=True)
def _nothing_chosen_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget what an earlier test started; both the choice and the variable come back afterwards."""
    monkeypatch.setattr(runtime, "_chosen", None)
    monkeypatch.delenv(LLVM_VARIABLE, raising=False)


def library(folder: Path, name: str) -> Path:
    """A file that is called like a library and cannot be loaded."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_bytes(b"not a library")
    return path


def without_package(monkeypatch: pytest.MonkeyPatch, system: Path) -> None:
    """No karellen-llvm-core, and only ``system`` to search."""
    monkeypatch.setattr(runtime, "LLVM_PACKAGE", "no-such-package")
    monkeypatch.setattr(runtime, "_SYSTEM_PATTERNS", ((str(system), "libLLVM*"),))


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM-15.so.1", "15"),
        ("libLLVM-14.0.6.so", "14"),
        ("libLLVM-18.so", "18"),
        ("libLLVM.so.23.1", "23.1"),
        ("libLLVM.so.19", "19"),
    ],
)
def test_version_in_the_name(tmp_path: Path, name: str, version: str) -> None:
    assert llvm_version(library(tmp_path, name)) == version


def test_version_behind_a_link(tmp_path: Path) -> None:
    """A plain name is followed to the file that it stands for."""
    link = tmp_path / "libLLVM.so"
    link.symlink_to(library(tmp_path, "libLLVM-15.so.1"))
    assert llvm_version(link) == "15"


def test_library_without_version_is_asked_in_another_process(monkeypatch: pytest.MonkeyPatch) -> None:
    choice = find_llvm()
    monkeypatch.setattr(runtime, "_NAME_VERSION", re.compile("no name has a version"))
    asked = llvm_version(choice.path)
    assert asked.startswith(choice.version)
    assert asked.count(".") == 2  # the library tells all three numbers


def test_file_that_is_no_library(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="asking for its LLVM version failed") as caught:
        llvm_version(library(tmp_path, "libLLVM.so"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("version", [14, 15])
def test_the_users_old_library_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, version: int
) -> None:
    path = library(tmp_path, f"libLLVM-{version}.so.1")
    monkeypatch.setenv(LLVM_VARIABLE, str(path))
    with pytest.raises(InputError) as caught:
        find_llvm()
    message = str(caught.value)
    assert str(path) in message
    assert f"LLVM {version} found" in message
    assert LLVM_COMMAND in message
    assert "\n" not in message


@pytest.mark.parametrize("path", OLD, ids=lambda p: p.name)
def test_a_real_old_library_is_refused(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs where the system has one; the fake ones above stand in elsewhere."""
    monkeypatch.setenv(LLVM_VARIABLE, str(path))
    with pytest.raises(InputError, match=r"LLVM 1[45] found .* pip install karellen-llvm-core"):
        runtime.start()


@pytest.mark.skipif(not LLVM_15, reason="no LLVM 15 on this system")
def test_an_old_library_with_a_lying_name_is_refused_after_loading(tmp_path: Path) -> None:
    """Dr.Jit's own answer is checked too; in a process of its own, for a library cannot be unloaded."""
    liar = tmp_path / "libLLVM-20.so"
    liar.write_bytes(LLVM_15[0].read_bytes())
    code = "from sfsnet_dr.core import runtime; runtime.start()"
    environment = {**os.environ, LLVM_VARIABLE: str(liar)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 1
    assert "InputError" in done.stderr
    assert "LLVM 15.0" in done.stderr
    assert LLVM_COMMAND in done.stderr


def test_the_users_missing_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LLVM_VARIABLE, "/nowhere/libLLVM-20.so")
    with pytest.raises(InputError, match=r"DRJIT_LIBLLVM_PATH=/nowhere/libLLVM-20\.so: no such file"):
        find_llvm()


def test_the_users_choice_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = library(tmp_path, "libLLVM-17.so")
    monkeypatch.setenv(LLVM_VARIABLE, str(path))
    choice = find_llvm()
    assert (choice.path, choice.version, choice.source) == (path, "17", LLVM_VARIABLE)


def test_newest_of_the_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_package(monkeypatch, tmp_path)
    for name in ("libLLVM-9.so.1", "libLLVM-15.so.1", "libLLVM.so.18.1", "libLLVM-17.so.1", "libLLVM.so"):
        library(tmp_path, name)
    choice = find_llvm()
    assert choice.path.name == "libLLVM.so.18.1"
    assert (choice.major, choice.source) == (18, "system")


def test_only_old_ones_in_the_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_package(monkeypatch, tmp_path)
    library(tmp_path, "libLLVM-14.so.1")
    library(tmp_path, "libLLVM-15.so.1")
    with pytest.raises(
        InputError, match=r"libLLVM-15\.so\.1: LLVM 15 found \(chosen by system\), 16 or later"
    ):
        find_llvm()


def test_none_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_package(monkeypatch, tmp_path)
    with pytest.raises(InputError, match="libLLVM: none found, LLVM 16 or later is needed: pip install"):
        find_llvm()


def test_package_found_by_its_own_list_of_files() -> None:
    try:
        from importlib.metadata import version

        expected = version(runtime.LLVM_PACKAGE)
    except ModuleNotFoundError:
        pytest.skip("karellen-llvm-core has no wheel for this system")
    choice = find_llvm()
    assert choice.source == runtime.LLVM_PACKAGE
    assert expected.startswith(choice.version)


def test_start_twice_and_what_was_loaded() -> None:
    runtime.start()
    runtime.start()
    import mitsuba as mi

    assert mi.variant() == runtime.DEFAULT_VARIANT
    assert runtime.loaded_llvm_version().startswith(find_llvm().version)
    assert runtime.threads() >= 1


def test_unknown_variant_names_the_nearest() -> None:
    with pytest.raises(
        InputError, match="'llvm_ad_rgp': not compiled into Mitsuba; did you mean 'llvm_ad_rgb'"
    ):
        runtime.start("llvm_ad_rgp")
