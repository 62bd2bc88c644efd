"""The overview of all commands, and of those that share their first word (``bench``, ``weights``)."""

from __future__ import annotations

from collections.abc import Mapping

from sfsnet_dr.cli.commands import COMMANDS, GROUPS

_EXIT_CODES = "Exit codes: 0 done, 1 the work failed or found a difference, 2 invalid input, 130 interrupted."


def overview() -> str:
    """Return what ``sfsnet-dr --help`` prints."""
    width = max(map(len, COMMANDS))
    groups = "\n\n".join(f"{title}:\n{_rows(group, width)}" for title, group in GROUPS.items())
    return (
        "Physically based inverse rendering of faces.\n\n"
        "usage: sfsnet-dr COMMAND [OPTIONS]\n"
        "       sfsnet-dr --version\n"
        "       sfsnet-dr --completion bash|zsh   print a script that completes commands and options\n\n"
        f"{groups}\n\n"
        "`sfsnet-dr COMMAND --help` explains a command and gives an example.\n"
        f"{_EXIT_CODES}\n"
        "First steps: `sfsnet-dr doctor`, then `sfsnet-dr demo`."
    )


def subcommands(word: str) -> dict[str, str]:
    """Return command -> summary for the commands of two words that begin with ``word``; {} if none does."""
    return {name: line for name, (_, line) in COMMANDS.items() if name.startswith(f"{word} ")}


def group_overview(word: str) -> str:
    """Return what ``sfsnet-dr bench --help`` prints: the commands that begin with ``word``."""
    rows = subcommands(word)
    lines = "\n".join(f"  {name:<{max(map(len, rows))}}  {line}" for name, line in rows.items())
    first = next(iter(rows))
    return f"usage: sfsnet-dr {word} COMMAND [OPTIONS]\n\n{lines}\n\nExample: sfsnet-dr {first} --help"


def _rows(group: Mapping[str, tuple[object, str]], width: int) -> str:
    return "\n".join(f"  {name:<{width}}  {line}" for name, (_, line) in group.items())
