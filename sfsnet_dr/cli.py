"""The ``sfsnet-dr`` command: which command is meant, how it ends, and what goes to standard output.

Bad input ends with one line on standard error and exit code 2, failed work with one line and exit code 1, an
interrupt with 130. With ``--json`` standard output holds a JSON array of records (for ``doctor``: its report)
and nothing else; whatever a library prints goes to standard error.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from contextlib import nullcontext, redirect_stderr
from io import StringIO

import tyro

from sfsnet_dr.base.checks import BadInput, WorkFailed, nearest
from sfsnet_dr.base.streams import standard_output_to_error
from sfsnet_dr.commands.registry import COMMANDS
from sfsnet_dr.commands.result import Command

#: How the parts of tyro's messages begin that only say where to read more.
_MORE = ("For full helptext", "Argument helptext")


def overview() -> str:
    """What `sfsnet-dr` alone prints."""
    width = max(map(len, COMMANDS))
    rows = "\n".join(f"  {name:<{width}}  {line}" for name, (_, line) in COMMANDS.items())
    return (
        f"Physically based inverse rendering of faces.\n\nusage: sfsnet-dr COMMAND ...\n\n{rows}\n\n"
        "`sfsnet-dr COMMAND --help` explains a command. Start with `sfsnet-dr doctor`, then `sfsnet-dr demo`."
    )


def parse(argv: Sequence[str]) -> Command:
    """The command that the arguments name.

    Raises:
        BadInput: for an unknown command, or arguments that it does not take.
        SystemExit: with 0 for --help.
    """
    name, rest = _split(argv)
    if name not in COMMANDS:
        raise BadInput(f"command {name!r} found; {nearest(name, COMMANDS)}")
    prog, told = f"sfsnet-dr {name}", StringIO()
    try:
        with redirect_stderr(told):
            return tyro.cli(COMMANDS[name][0], prog=prog, args=rest, config=(tyro.conf.FlagCreatePairsOff,))
    except SystemExit as end:
        if not end.code:
            raise
        raise BadInput(f"{name}: {_unboxed(told.getvalue())}; see `{prog} --help`") from end


def _unboxed(box: str) -> str:
    """What tyro says in a box of several lines, in one; its parts on where to read more are left out."""
    rows = [row.strip(" │") for row in box.splitlines() if row.strip().startswith("│")]
    parts = [" ".join(part.split()) for part in "\n".join(rows).split("───")]
    kept = [part.strip("─ ") for part in parts if not part.strip("─ ").startswith(_MORE)]
    return "; ".join(part.rstrip(".") for part in kept if part) or " ".join(box.split())


def _split(argv: Sequence[str]) -> tuple[str, list[str]]:
    """The command's one or two words (``bench synth``), and its arguments."""
    words = 2 if any(name.startswith(f"{argv[0]} ") for name in COMMANDS) else 1
    return " ".join(argv[:words]), list(argv[words:])


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    argv = sys.argv[1:] if argv is None else argv
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(overview())
        return 0
    try:
        command = parse(argv)
        with standard_output_to_error() if command.as_json else nullcontext():
            result = command.run()
        print(result.json if command.as_json else result.text, flush=True)
        return result.code
    except BadInput as error:
        return _fail(error, 2)
    except WorkFailed as error:
        return _fail(error, 1)
    except KeyboardInterrupt:
        return _fail("interrupted", 130)
    except BrokenPipeError:  # the reader, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _fail(error: object, code: int) -> int:
    print("sfsnet-dr: " + str(error).replace("\n", " "), file=sys.stderr)
    return code
