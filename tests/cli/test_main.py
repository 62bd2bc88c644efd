"""The command: help, exit codes, one line for every bad input, and standard output for machines."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.bad_commands import BAD, decompose, empty_mask, missing

from sfsnet_dr.cli import start
from sfsnet_dr.cli.commands import COMMANDS
from sfsnet_dr.cli.common import Result
from sfsnet_dr.cli.main import main
from sfsnet_dr.core.errors import RunError
from sfsnet_dr.core.image_io import write_png
from sfsnet_dr.models.sfsnet import SfSNet
from sfsnet_dr.models.weights import save_weights

PROGRAM = Path(sys.executable).with_name("sfsnet-dr")
Run = Callable[..., str]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A good picture, and good weights of a tiny network."""
    torch.manual_seed(0)
    save_weights(tmp_path / "good.safetensors", SfSNet(4, 4, 1))
    write_png(tmp_path / "face.png", np.full((128, 128, 3), 0.4))
    return tmp_path


@pytest.mark.parametrize("case", BAD, ids=lambda case: case.__name__)
def test_bad_input_is_one_line_and_leaves_nothing(
    case: Callable[[Path], list[str]], folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    arguments = case(folder)
    before = sorted(folder.rglob("*"))
    code = main(arguments)
    told = capfd.readouterr()
    assert code == 2
    assert told.out == ""
    [line] = told.err.splitlines()
    for part in BAD[case]:
        assert part in line
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("case", [missing, empty_mask], ids=lambda case: case.__name__)
def test_the_installed_program_ends_with_the_code_and_the_line(
    case: Callable[[Path], list[str]], folder: Path
) -> None:
    # In a process of its own, because libraries may still speak up while the interpreter ends.
    done = subprocess.run([PROGRAM, *case(folder)], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert "Traceback" not in done.stderr


def test_good_input_is_decomposed(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(decompose(folder)) == 0
    told = capfd.readouterr()
    assert f"written: {folder / 'out' / 'face'}" in told.out
    assert "decompose.face.reconstruction.mae_8bit" in told.out
    assert (folder / "out/face/sheet.png").is_file()


def test_json_is_all_that_goes_to_standard_output(folder: Path) -> None:
    done = subprocess.run(
        [PROGRAM, *decompose(folder, "face.png", "--json")], capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    [record] = json.loads(done.stdout)
    assert record["what"] == "decompose.face.reconstruction.mae_8bit"
    assert record["command"].startswith("sfsnet-dr decompose ")
    assert record["versions"]["torch"].startswith("2.")


def test_what_a_library_prints_does_not_reach_the_json(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def chatty(_: start.Demo) -> Result:
        print("hello from Python")
        subprocess.run(["echo", "hello from a child process"], check=True)
        return Result(text="text", json="[]")

    monkeypatch.setattr(start.Demo, "run", chatty)
    assert main(["demo", "--json"]) == 0
    told = capfd.readouterr()
    assert told.out == "[]\n"
    assert told.err.count("hello") == 2


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (RunError("the loss\nis not finite"), 1, "sfsnet-dr: the loss is not finite\n"),
        (KeyboardInterrupt(), 130, "sfsnet-dr: interrupted\n"),
    ],
)
def test_other_ends_have_their_codes(
    error: BaseException,
    code: int,
    line: str,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    def fail(_: start.Demo) -> Result:
        raise error

    monkeypatch.setattr(start.Demo, "run", fail)
    assert main(["demo"]) == code
    assert capfd.readouterr().err == line


@pytest.mark.parametrize("name", COMMANDS)
def test_each_help_has_an_example_that_is_accepted(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    import shlex

    from sfsnet_dr.cli.main import parse

    with pytest.raises(SystemExit) as end:
        main([name, "--help"])
    assert end.value.code == 0
    [example] = [x for x in capfd.readouterr().out.splitlines() if x.startswith("Example: sfsnet-dr ")]
    assert isinstance(parse(shlex.split(example)[2:]), COMMANDS[name][0])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["pseudo-label", "x", "--out", "y", "--weight", "x"],
            "Missing from sfsnet-dr pseudo-label: --weights FILE",
        ),
        (["synth", "--outt", "x"], "Unrecognized options: --outt x"),
        (["synth", "--out", "x", "--count", "abc"], "Error parsing --count: invalid literal"),
        (
            ["synth", "--out", "x", "--face-model", "flame"],
            "invalid choice 'flame' for argument '--face-model'",
        ),
        (["synth", "--out", "x", "--seed"], "Missing value for argument '--seed'"),
        (["bench", "synth", "--many"], "see `sfsnet-dr bench synth --help`"),
    ],
)
def test_wrong_arguments_end_with_2_and_one_line(
    arguments: list[str], words: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "50")  # a narrow terminal breaks no words apart
    assert main(arguments) == 2
    told = capfd.readouterr()
    assert told.out == ""
    assert told.err.startswith(f"sfsnet-dr: {arguments[0]}")
    assert told.err.count("\n") == 1
    assert words in told.err
    assert not set("│╭─") & set(told.err)


def test_the_package_is_the_command() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "sfsnet_dr", "no-such"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "no-such" in done.stderr


def test_a_reader_that_stops_early_sees_no_traceback() -> None:
    code = 'from sfsnet_dr.cli.main import main; main(["doctor", "--json"])'
    line = f"{shlex.quote(sys.executable)} -c {shlex.quote(code)} | head -c 1"
    done = subprocess.run(line, shell=True, capture_output=True, text=True, check=False)
    assert done.stdout == "{"
    assert done.stderr == ""
