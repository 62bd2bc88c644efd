"""The manifest survives a crash in the middle of a line and refuses to mix datasets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.manifest import NAME, Entry, Manifest


def entry(seed: int, spec: str = "abc") -> Entry:
    """A line of the manifest."""
    return Entry(f"face_{seed:05d}.exr", seed, "anny", spec, "00" * 32, {"mitsuba": "3.9.1"})


def test_entries_come_back_in_order(tmp_path: Path) -> None:
    manifest = Manifest(tmp_path)
    assert manifest.entries == []
    for seed in (4, 2, 3):
        manifest.append(entry(seed))
    assert Manifest(tmp_path).entries == [entry(4), entry(2), entry(3)] == manifest.entries
    assert len((tmp_path / NAME).read_text().splitlines()) == 3


def test_a_torn_last_line_is_dropped_and_written_over(tmp_path: Path) -> None:
    manifest = Manifest(tmp_path)
    manifest.append(entry(1))
    whole = (tmp_path / NAME).read_bytes()
    for cut in (1, 10, len(whole) - 1):
        (tmp_path / NAME).write_bytes(whole + whole[:-cut])
        resumed = Manifest(tmp_path)
        assert resumed.entries == [entry(1)]
        resumed.append(entry(2))
        assert Manifest(tmp_path).entries == [entry(1), entry(2)]


def test_only_bundles_that_are_listed_and_present_are_finished(tmp_path: Path) -> None:
    manifest = Manifest(tmp_path, "abc")
    for seed in (1, 2):
        manifest.append(entry(seed))
    for seed in (2, 3):
        (tmp_path / entry(seed).file).write_bytes(b"x")
    assert Manifest(tmp_path).finished_seeds() == {2}


def test_another_dataset_is_refused(tmp_path: Path) -> None:
    manifest = Manifest(tmp_path)
    manifest.append(entry(1))
    with pytest.raises(InputError, match=rf"{NAME}: holds bundles of specification xyz, abc expected"):
        manifest.append(entry(2, "xyz"))
    with pytest.raises(InputError, match="specification abc, xyz expected; choose another folder"):
        Manifest(tmp_path, "xyz")
    with pytest.raises(InputError, match="already listed"):
        manifest.append(replace(entry(9), file=entry(1).file))
    assert Manifest(tmp_path).entries == [entry(1)]


@pytest.mark.parametrize("line", ["{", "[]", '{"file": "a"}', "3"])
def test_a_damaged_line_is_named(tmp_path: Path, line: str) -> None:
    Manifest(tmp_path).append(entry(1))
    with (tmp_path / NAME).open("a") as file:
        file.write(line + "\n")
    with pytest.raises(InputError, match=rf"{NAME}:2: not a manifest line"):
        Manifest(tmp_path)
