from __future__ import annotations

import getpass
import hashlib
import json
import platform
from pathlib import Path

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
