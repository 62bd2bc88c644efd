"""The ``sfsnet-dr`` command: which command is meant, how it ends, and what goes to standard output.

Bad input ends with one line on standard error and exit code 2, failed work with one line and exit code 1, an
interrupt with 130. With ``--json`` standard output holds a JSON array of records (for ``doctor``: its report)
and nothing else; whatever a library prints goes to standard error.

Which commands there are.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from contextlib import nullcontext, redirect_stderr
from io import StringIO
from typing import Final

import tyro

from sfsnet_dr.cli.bench import BenchLoss, BenchRelight, BenchRender, BenchSynth, BenchTrain
from sfsnet_dr.cli.common import Command
from sfsnet_dr.cli.evaluation import DataCheck, Evaluate, PhotometricStereo
from sfsnet_dr.cli.faces import Relight, Show, Synth
from sfsnet_dr.cli.start import Demo, Doctor
from sfsnet_dr.cli.training import Ablations, Decompose, PseudoLabel, Stages, Train
from sfsnet_dr.cli.validation import Regress, Stability, Validate, WorstLight
from sfsnet_dr.cli.weights import FitLights, WeightsCheck, WeightsList, WeightsMean, WeightsPack
from sfsnet_dr.core.errors import InputError, RunError, nearest
from sfsnet_dr.core.host import standard_output_to_error

#: Commands by the words on the command line, with the line that the overview shows.
COMMANDS: Final[dict[str, tuple[type[Command], str]]] = {
    "doctor": (Doctor, "Check that this machine can render"),
    "synth": (Synth, "Render faces with their ground truth"),
    "show": (Show, "Make a contact sheet of rendered faces"),
    "relight": (Relight, "Put one rendered face under another light"),
    "train": (Train, "Train a network by a recipe"),
    "pseudo-label": (PseudoLabel, "Label photographs with a network's answers"),
    "stages": (Stages, "Run every stage of training and measure the networks"),
    "ablations": (Ablations, "Measure what each part of the method is worth"),
    "data check": (DataCheck, "Count what a folder of a face database holds"),
    "photometric-stereo": (PhotometricStereo, "Find normals from photographs under known lights"),
    "evaluate": (Evaluate, "Measure networks and baselines on faces with known normals"),
    "fit-lights": (FitLights, "Learn from photographs which lights there are"),
    "decompose": (Decompose, "Take photographs of faces apart"),
    "weights list": (WeightsList, "Name the trained networks that come with the package"),
    "weights check": (WeightsCheck, "Measure them and compare with their cards"),
    "weights pack": (WeightsPack, "Keep a network's weights in eight bits"),
    "weights mean": (WeightsMean, "Average networks that were trained on from one another"),
    "validate": (Validate, "Measure the SH renderer against the path tracer"),
    "worst-light": (WorstLight, "Find the light under which the SH renderer is most wrong"),
    "stability": (Stability, "Put hard cases to every SH renderer and the loss"),
    "bench synth": (BenchSynth, "Measure how fast faces are rendered"),
    "bench relight": (BenchRelight, "Measure relit faces against path-traced ones"),
    "regress": (Regress, "Hold every renderer to what it should show"),
    "bench loss": (BenchLoss, "Time the reconstruction loss against torch and the memory"),
    "bench render": (BenchRender, "Time the SH renderer against torch and the memory"),
    "bench train": (BenchTrain, "Time the steps of training and what they are made of"),
    "demo": (Demo, "Run the whole pipeline and write a report"),
}


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
        InputError: for an unknown command, or arguments that it does not take.
        SystemExit: with 0 for --help.
    """
    name, rest = _split(argv)
    if name not in COMMANDS:
        raise InputError(f"command {name!r} found; {nearest(name, COMMANDS)}")
    prog, told = f"sfsnet-dr {name}", StringIO()
    try:
        with redirect_stderr(told):
            return tyro.cli(COMMANDS[name][0], prog=prog, args=rest, config=(tyro.conf.FlagCreatePairsOff,))
    except SystemExit as end:
        if not end.code:
            raise
        raise InputError(f"{name}: {_unboxed(told.getvalue())}; see `{prog} --help`") from end


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
    except InputError as error:
        return _fail(error, 2)
    except RunError as error:
        return _fail(error, 1)
    except KeyboardInterrupt:
        return _fail("interrupted", 130)
    except BrokenPipeError:  # the reader, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _fail(error: object, code: int) -> int:
    print("sfsnet-dr: " + str(error).replace("\n", " "), file=sys.stderr)
    return code
