"""Shell completion of commands, options and choices, from the scripts that tyro writes."""

from __future__ import annotations

from contextlib import redirect_stdout, suppress
from dataclasses import dataclass
from functools import reduce
from io import StringIO
from operator import or_
from typing import Annotated, Any, Final

import tyro

from sfsnet_dr.cli.commands import COMMANDS
from sfsnet_dr.core.errors import InputError, nearest

SHELLS: Final = ("bash", "zsh")


@dataclass(frozen=True)
class _Help:
    """Stands for ``sfsnet-dr bench help``: tyro drops a group that holds one command."""


def completion_script(shell: str) -> str:
    """Return a completion script to source, as in ``eval "$(sfsnet-dr --completion bash)"``.

    Args:
        shell: one of ``SHELLS``.

    Raises:
        InputError: for another shell.
    """
    if shell not in SHELLS:
        raise InputError(f"--completion: {shell!r} found; {nearest(shell, SHELLS)}")
    with redirect_stdout(StringIO()) as script, suppress(SystemExit):
        tyro.cli(
            _all_commands(),
            prog="sfsnet-dr",
            args=["--tyro-print-completion", shell],
            config=(tyro.conf.FlagCreatePairsOff,),
        )
    return script.getvalue().rstrip("\n")


def _all_commands() -> Any:
    """Return one union type of all commands; those of two words form a union of their own."""
    first_words = dict.fromkeys(name.split()[0] for name in COMMANDS)
    return _union([_command(word) if word in COMMANDS else _group(word) for word in first_words])


def _group(word: str) -> Any:
    members = [name for name in COMMANDS if name.startswith(f"{word} ")]
    kinds = [*map(_command, members), Annotated[_Help, tyro.conf.subcommand("help")]]
    return Annotated[_union(kinds), tyro.conf.subcommand(word, description=f"{word} ...")]


def _command(name: str) -> Any:
    kind, summary = COMMANDS[name]
    return Annotated[kind, tyro.conf.subcommand(name.split()[-1], description=summary)]


def _union(kinds: list[Any]) -> Any:
    return reduce(or_, kinds)
