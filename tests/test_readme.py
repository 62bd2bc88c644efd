"""README's commands are real: each is parsed by the command itself, each make target and file exists."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import pytest

from sfsnet_dr.cli.main import parse
from sfsnet_dr.core.errors import InputError

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


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


@pytest.mark.parametrize("command", commands(TEXT) + inline(TEXT), ids=" ".join)
def test_command_of_the_readme_is_accepted(command: list[str]) -> None:
    check(command)


def test_the_two_commands_are_there() -> None:
    assert ["make", "demo"] in commands(TEXT)
    assert ["make", "test"] in commands(TEXT)


def test_links_lead_to_files() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", TEXT):
        if "://" not in target:
            assert (ROOT / target).exists(), target


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
