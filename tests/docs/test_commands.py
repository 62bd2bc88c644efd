"""Commands of README and docs are real: parsed by the command itself, make targets and files exist."""

from __future__ import annotations

import contextlib
import re
import shlex
import subprocess
from pathlib import Path

import pytest

from sfsnet_dr.cli.help import subcommands
from sfsnet_dr.cli.main import parse
from sfsnet_dr.core.errors import InputError

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted(path for path in (ROOT / "docs").glob("*.md") if path.name != "cli.md"),
    *sorted((ROOT / "sfsnet_dr" / "models" / "weights").glob("*.md")),
]
TEXT = "\n".join(path.read_text(encoding="utf-8") for path in PAGES)


def commands(text: str) -> list[list[str]]:
    """The lines of all ``sh`` blocks as arguments, settings of variables before them left out."""
    blocks = re.findall(r"^```sh\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    lines = [shlex.split(line, comments=True) for block in blocks for line in block.splitlines()]
    return [[w for i, w in enumerate(line) if i or not re.match(r"[A-Z_]+=", w)] for line in lines if line]


def inline(text: str) -> list[list[str]]:
    """Commands between backticks in the running text."""
    return [shlex.split(code) for code in re.findall(r"`((?:sfsnet-dr|make) [^`\n]+)`", text)]


def check(command: list[str]) -> None:
    program, *arguments = command
    if program == "make":
        targets = [a for a in arguments if "=" not in a]
        subprocess.run(["make", "-n", *targets], cwd=ROOT, check=True, capture_output=True)
    elif arguments[1:] != ["--help"]:
        assert program == "sfsnet-dr"
        parse(arguments)
        for word in arguments:
            if word.startswith(("scenes/", "training/", "eval/")):
                assert (ROOT / word).is_file(), word


@pytest.mark.parametrize("command", commands(TEXT), ids=" ".join)
def test_commands_are_accepted(command: list[str]) -> None:
    check(command)


@pytest.mark.parametrize("command", inline(TEXT), ids=" ".join)
def test_commands_in_the_text_name_what_there_is(command: list[str]) -> None:
    """They may leave out what a command needs, and stand DIR for a folder."""
    if command[1:2] in (["--help"], ["--version"], ["COMMAND"]) or subcommands(" ".join(command[1:])):
        return
    with contextlib.suppress(InputError):
        check(command)
        return
    with pytest.raises(InputError, match=None if any(map(str.isupper, command)) else "Missing"):
        check(command)


def test_the_two_commands_are_there() -> None:
    assert ["make", "demo"] in commands(README)
    assert ["make", "test"] in commands(README)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), target


def test_the_readme_is_short() -> None:
    assert len(README.split()) <= 950


def test_a_wrong_command_would_be_seen(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="--outt"):
        check(["sfsnet-dr", "train", "training/recipes/smoke.toml", "--outt", "x"])
    with pytest.raises(InputError):
        check(["sfsnet-dr", "trian"])
    with pytest.raises(subprocess.CalledProcessError):
        check(["make", "no-such-target"])
    with pytest.raises(AssertionError):
        check(["sfsnet-dr", "train", "training/recipes/absent.toml", "--out", "x"])
    capsys.readouterr()
