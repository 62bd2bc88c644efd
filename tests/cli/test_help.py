"""Help without a command: the overview, groups of commands, version, and completion scripts."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

import sfsnet_dr
from sfsnet_dr.cli import main as cli
from sfsnet_dr.cli.commands import COMMANDS
from sfsnet_dr.cli.completion import completion_script
from sfsnet_dr.cli.help import overview, subcommands
from sfsnet_dr.cli.renamed import RENAMED_COMMANDS, RENAMED_OPTIONS

GROUPS = sorted({name.split()[0] for name in COMMANDS if " " in name})


def test_alone_it_prints_the_overview(capfd: pytest.CaptureFixture[str]) -> None:
    for arguments in ([], ["--help"], ["-h"], ["help"]):
        assert cli.main(arguments) == 0
        assert capfd.readouterr().out == overview() + "\n"
    assert all(f"  {name} " in overview() for name in COMMANDS)


def test_the_overview_fits_a_terminal_of_100_columns() -> None:
    assert max(map(len, overview().splitlines())) <= 100


@pytest.mark.parametrize("word", GROUPS)
@pytest.mark.parametrize("more", [[], ["--help"], ["-h"], ["help"]])
def test_a_group_lists_its_commands(word: str, more: list[str], capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.main([word, *more]) == 0
    printed = capfd.readouterr().out
    assert [name for name in COMMANDS if f"  {name} " in printed] == list(subcommands(word))


def test_an_unknown_command_of_a_group_is_refused_with_the_nearest(capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "los"]) == 2
    assert "did you mean 'bench loss'?" in capfd.readouterr().err


def test_the_version_is_that_of_the_package(capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capfd.readouterr().out == f"sfsnet-dr {sfsnet_dr.__version__}\n"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["de"], {"demo", "decompose"}),
        (["bench", ""], {name.split()[1] for name in COMMANDS if name.startswith("bench ")}),
        (["decompose", "--ey"], {"--eyes"}),
        (["synth", "--face-model", ""], {"anny", "ict", "basel"}),
    ],
)
def test_bash_completes_commands_options_and_choices(
    words: list[str], expected: set[str], tmp_path: Path
) -> None:
    script = tmp_path / "completion.bash"
    script.write_text(
        f"{completion_script('bash')}\n"
        f"COMP_WORDS=(sfsnet-dr {' '.join(word or repr('') for word in words)}); COMP_CWORD={len(words)}\n"
        "_tyro_sfsnet_dr\n"
        'echo "${COMPREPLY[@]}"\n'
    )
    done = subprocess.run(["bash", script], capture_output=True, text=True, check=True)
    assert expected <= set(done.stdout.split())
    if words[-1]:
        assert expected == set(done.stdout.split())


def test_other_shells_are_refused(capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--completion", "fish"]) == 2
    assert capfd.readouterr().err == "sfsnet-dr: --completion: 'fish' found; allowed: bash, zsh\n"


def test_zsh_gets_a_script_of_its_own() -> None:
    assert completion_script("zsh").startswith("#compdef sfsnet-dr")


@pytest.mark.parametrize("old", RENAMED_COMMANDS)
def test_an_old_command_is_refused_with_its_new_name(old: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.main([*old.split(), "x"]) == 2
    told = capfd.readouterr()
    assert told.err == f"sfsnet-dr: command {old!r} is now called {RENAMED_COMMANDS[old]!r}\n"
    assert RENAMED_COMMANDS[old] in COMMANDS
    assert old not in COMMANDS


@pytest.mark.parametrize(
    ("command", "old", "new"),
    [(name, old, new) for name, pairs in RENAMED_OPTIONS.items() for old, new in pairs.items()],
)
def test_an_old_option_still_works_with_a_note(
    command: str, old: str, new: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        cli.main([*command.split(), "--help"])
    assert new in capfd.readouterr().out
    assert cli._with_new_options(command, [old, "1", f"{old}=2", "x"]) == [new, "1", f"{new}=2", "x"]
    assert capfd.readouterr().err.count(f"{command}: {old} is now called {new}") == 2
