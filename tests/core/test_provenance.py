from __future__ import annotations

import getpass
import hashlib
import json
import platform
from pathlib import Path

import pytest

from sfsnet_dr.core import provenance


def test_versions_of_what_is_there() -> None:
    found = provenance.versions(["numpy", "no-such-package"])
    assert set(found) == {"python", "numpy"}
    assert found["python"] == platform.python_version()


def test_machine_names_nobody() -> None:
    facts = provenance.machine()
    assert isinstance(facts["cores"], int)
    assert facts["cores"] >= 1
    text = json.dumps(facts)
    assert platform.node() not in text
    assert getpass.getuser() not in text
    assert "/" not in text.replace("/proc", "")


def test_sha256_of_abc(tmp_path: Path) -> None:
    """FIPS 180-2, appendix B.1."""
    expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    path = tmp_path / "abc"
    path.write_bytes(b"abc")
    assert provenance.sha256(b"abc") == provenance.sha256(path) == expected
    assert provenance.sha256(b"") == hashlib.sha256().hexdigest()


def test_no_revision_outside_a_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "_PACKAGE_DIR", tmp_path)
    assert provenance.git_revision() is None


def test_revision_of_a_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "_PACKAGE_DIR", tmp_path)
    if provenance._git("init") is None:
        pytest.skip("no git")
    commit(tmp_path / "other")
    file = tmp_path / "__init__.py"
    file.touch()
    assert provenance.git_revision() is None  # installed inside somebody else's repository
    commit(file)
    clean = provenance.git_revision()
    assert clean is not None
    assert len(clean) == 40
    file.write_text("changed")
    assert provenance.git_revision() == f"{clean}-dirty"


def commit(file: Path) -> None:
    file.touch()
    provenance._git("add", file.name)
    who = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
    provenance._git(*who, "commit", "-m", "one file", "--no-verify")
