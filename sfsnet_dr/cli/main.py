"""The ``sfsnet-dr`` command: parse arguments, run one command, print its result, return the exit code.

Exit codes: 0 for success, 1 for failed work (``RunError``, or a check that found a difference), 2 for invalid
input (``InputError``), 130 for an interrupt. Errors are one line on standard error. With ``--json`` standard
output holds a JSON array of records (for ``doctor``: its report) and nothing else; whatever a library prints
goes to standard error.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from contextlib import nullcontext, redirect_stderr
from io import StringIO
from typing import Final

import tyro

import sfsnet_dr
from sfsnet_dr.cli.commands import COMMANDS
from sfsnet_dr.cli.common import Command
from sfsnet_dr.cli.help import group_overview, overview, subcommands
from sfsnet_dr.cli.renamed import RENAMED_COMMANDS, RENAMED_OPTIONS
from sfsnet_dr.core.errors import InputError, RunError, nearest
from sfsnet_dr.core.host import standard_output_to_error

#: How the parts of tyro's messages begin that only say where to read more.
_MORE: Final = ("For full helptext", "Argument helptext")

_HELP: Final = ("-h", "--help", "help")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    Args:
        argv: the words after ``sfsnet-dr``; those of the process if left out.
    """
    argv = sys.argv[1:] if argv is None else argv
    try:
        text = _text_without_command(argv)
        if text is not None:
            print(text, flush=True)
            return 0
        command = parse(argv)
        with standard_output_to_error() if command.as_json else nullcontext():
            result = command.run()
        print(result.json if command.as_json else result.text, flush=True)
        return result.code
    except InputError as error:
        return _fail(error, 2)
    except RunError as error:
        return _fail(error, 1)
    except KeyboardInterrupt:
        return _fail("interrupted", 130)
    except BrokenPipeError:  # the reader, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def parse(argv: Sequence[str]) -> Command:
    """Return the command that the arguments name, with its options set.

    Raises:
        InputError: for an unknown command, or options and values that it does not take.
        SystemExit: with code 0 for ``--help``.
    """
    name, rest = _split(argv)
    if name in RENAMED_COMMANDS:
        raise InputError(f"command {name!r} is now called {RENAMED_COMMANDS[name]!r}")
    if name not in COMMANDS:
        raise InputError(f"command {name!r} found; {nearest(name, COMMANDS)}; see `sfsnet-dr --help`")
    prog, messages, current = f"sfsnet-dr {name}", StringIO(), _with_new_options(name, rest)
    try:
        with redirect_stderr(messages):
            return tyro.cli(
                COMMANDS[name][0], prog=prog, args=current, config=(tyro.conf.FlagCreatePairsOff,)
            )
    except SystemExit as end:
        if not end.code:
            raise
        raise InputError(f"{name}: {_unboxed(messages.getvalue())}; see `{prog} --help`") from end


def _text_without_command(argv: Sequence[str]) -> str | None:
    """Return the text that the arguments ask for where they name no command to run, else None."""
    if not argv or argv[0] in _HELP:
        return overview()
    if argv[0] == "--version":
        return f"sfsnet-dr {sfsnet_dr.__version__}"
    if argv[0] == "--completion":
        from sfsnet_dr.cli.completion import completion_script

        return completion_script(" ".join(argv[1:]))
    if argv[0] not in COMMANDS and subcommands(argv[0]) and (len(argv) == 1 or argv[1] in _HELP):
        return group_overview(argv[0])
    return None


def _with_new_options(name: str, args: Sequence[str]) -> list[str]:
    """Replace options that were renamed; a note on standard error says so."""
    renamed = RENAMED_OPTIONS.get(name, {})
    current = []
    for arg in args:
        option, equals, value = arg.partition("=")
        if option in renamed:
            print(f"sfsnet-dr: {name}: {option} is now called {renamed[option]}", file=sys.stderr)
            arg = f"{renamed[option]}{equals}{value}"
        current.append(arg)
    return current


def _unboxed(box: str) -> str:
    """Return in one line what tyro prints in a box of several; its hints where to read more are left out."""
    rows = [row.strip(" │") for row in box.splitlines() if row.strip().startswith("│")]
    parts = [" ".join(part.split()) for part in "\n".join(rows).split("───")]
    kept = [part.strip("─ ") for part in parts if not part.strip("─ ").startswith(_MORE)]
    return "; ".join(part.rstrip(".") for part in kept if part) or " ".join(box.split())


def _split(argv: Sequence[str]) -> tuple[str, list[str]]:
    """Split the arguments into the command's one or two words (``bench synth``) and the rest."""
    names = [*COMMANDS, *RENAMED_COMMANDS]
    words = 2 if argv[0] not in COMMANDS and any(name.startswith(f"{argv[0]} ") for name in names) else 1
    return " ".join(argv[:words]), list(argv[words:])


def _fail(error: object, code: int) -> int:
    print("sfsnet-dr: " + str(error).replace("\n", " "), file=sys.stderr)
    return code
