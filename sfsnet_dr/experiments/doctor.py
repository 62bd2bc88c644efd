"""What ``sfsnet-dr doctor`` finds out: whether the renderer starts here, and with which versions.

The parts that can end a process (loading libLLVM, compiling, rendering) run in a process of their own, so
that an abort becomes a line in the report.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import sfsnet_dr
from sfsnet_dr.core import runtime
from sfsnet_dr.core.errors import InputError, NotInstalled
from sfsnet_dr.core.provenance import PACKAGES, machine, versions
from sfsnet_dr.core.worker_process import end_reason
from sfsnet_dr.render.renderers.remote import CYCLES_COMMAND, cycles_version

#: Distributions that add something and need not be there, with what installs them.
EXTRAS: Final = {
    "ray": "pip install 'sfsnet_dr[distributed]'",
    "tensorboard": "pip install 'sfsnet_dr[tensorboard]'",
    "flip-evaluator": "pip install 'sfsnet_dr[validation]'",
    "mediapipe": "pip install 'sfsnet_dr[align]'",
}
#: Present where a wheel of it exists; elsewhere a system LLVM takes its place, which the check "llvm" judges.
_REPLACEABLE: Final = (runtime.LLVM_PACKAGE,)

STEPS: Final = ("variant", "kernel", "render")
TIME_LIMIT: Final = 180.0
_PROBE: Final = (sys.executable, "-m", "sfsnet_dr.experiments.doctor", "--probe")


@dataclass(frozen=True)
class Check:
    """One thing looked at.

    Attributes:
        name: short name.
        ok: whether it is as it should be.
        detail: one line: what was found, and on failure what to do.
        values: what was found that a program may want: ``threads``, ``llvm_loaded``.
    """

    name: str
    ok: bool
    detail: str
    values: dict[str, str | int] = field(default_factory=dict)


@dataclass(frozen=True)
class Report:
    """The state of this installation.

    Attributes:
        checks: in the order they were made.
        llvm: path, version and source of the libLLVM chosen; None where there is no good one.
        variant: the Mitsuba variant that this package starts.
        versions: of Python and of the packages installed.
        machine: processor, cores, memory.
        extras: versions of the optional packages found; Cycles is in an environment of its own.
        missing: what installs each optional package that was not found.
    """

    checks: tuple[Check, ...]
    llvm: dict[str, str] | None
    variant: str
    versions: dict[str, str]
    machine: dict[str, str | int | float]
    extras: dict[str, str]
    missing: dict[str, str]

    @property
    def ok(self) -> bool:
        """Whether every check passed."""
        return all(check.ok for check in self.checks)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON, ``ok`` included."""
        return {"ok": self.ok, **asdict(self)}

    def to_json(self) -> str:
        """The report as a JSON object with ``ok`` and ``checks``."""
        return json.dumps(self.as_dict(), indent=2)

    def to_text(self) -> str:
        """The report for reading: a line a check, then what is installed."""
        width = max(len(check.name) for check in self.checks)
        lines = [
            f"{'ok    ' if check.ok else 'FAILED'}  {check.name:{width}}  {check.detail}"
            for check in self.checks
        ]
        for title, facts in (("versions", self.versions), ("machine", self.machine), ("extras", self.extras)):
            lines.append(
                f"{title}: {', '.join(f'{name} {value}' for name, value in facts.items()) or 'none'}"
            )
        lines += [f"not installed: {name} ({command})" for name, command in self.missing.items()]
        return "\n".join(lines)


def check_installation(time_limit: float = TIME_LIMIT) -> Report:
    """Look at this installation; never raises for what it finds.

    Args:
        time_limit: seconds that compiling and rendering may take together.
    """
    found = versions()
    llvm_check, llvm = _check_llvm()
    probes = run_probe(_PROBE, time_limit) if llvm_check.ok else _not_run(STEPS, "no good LLVM")
    extras, missing = _optional()
    return Report(
        checks=(_check_packages(found), llvm_check, *probes),
        llvm=llvm,
        variant=runtime.DEFAULT_VARIANT,
        versions=found,
        machine=machine(),
        extras=extras,
        missing=missing,
    )


def run_probe(command: Sequence[str], time_limit: float) -> list[Check]:
    """Run the probe's steps in a process of their own, one check a step.

    Args:
        command: a program that prints one JSON object (name, ok, detail) a line for each of :data:`STEPS`.
        time_limit: seconds.

    Returns:
        One check per step. The step during which the process ended is failed with the signal or exit code and
        its last line on standard error; steps after it are failed as not run.
    """
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=time_limit, env=_environment(), check=False
        )
        output, reason = done.stdout, end_reason(done.returncode, done.stderr, " before this step")
    except subprocess.TimeoutExpired as expired:
        output, reason = _text(expired.stdout), f"no answer within {time_limit:g} s; the process was ended"
    except OSError as error:
        output, reason = "", f"{command[0]} could not be started ({error.strerror})"
    checks = _parse(output)
    missing = STEPS[len(checks) :]
    if missing:
        checks += [Check(missing[0], False, reason), *_not_run(missing[1:], f"{missing[0]} failed")]
    return checks


def _check_packages(found: dict[str, str]) -> Check:
    missing = [name for name in PACKAGES if name not in found and name not in _REPLACEABLE]
    if missing:
        return Check(
            "packages", False, f"{', '.join(missing)} not installed: pip install {' '.join(missing)}"
        )
    return Check("packages", True, f"all {len(PACKAGES) - len(_REPLACEABLE)} needed are installed")


def _check_llvm() -> tuple[Check, dict[str, str] | None]:
    try:
        choice = runtime.find_llvm()
    except InputError as error:
        return Check("llvm", False, str(error)), None
    detail = f"LLVM {choice.version} from {choice.source}: {choice.path}"
    return Check("llvm", True, detail), {
        "path": str(choice.path),
        "version": choice.version,
        "source": choice.source,
    }


def _optional() -> tuple[dict[str, str], dict[str, str]]:
    """Versions of the optional packages found, and commands for the others."""
    found = versions(EXTRAS)
    del found["python"]
    missing = {name: command for name, command in EXTRAS.items() if name not in found}
    try:
        found["cycles"] = cycles_version()
    except NotInstalled:
        missing["cycles"] = CYCLES_COMMAND
    return found, missing


def _not_run(names: Sequence[str], why: str) -> list[Check]:
    return [Check(name, False, f"not run: {why}") for name in names]


def _parse(output: str) -> list[Check]:
    """Checks of the steps in order, as far as the process told of them; libraries may print other lines."""
    told: dict[str, Check] = {}
    for line in output.splitlines():
        try:
            check = Check(**json.loads(line))
        except (ValueError, TypeError):
            continue
        told[check.name] = check
    checks = []
    for name in STEPS:
        if name not in told:
            break
        checks.append(told[name])
    return checks


def _environment() -> dict[str, str]:
    """The child imports this very package, also where it runs from a checkout that is not installed."""
    root = str(Path(sfsnet_dr.__file__).resolve().parent.parent)
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def _text(output: str | bytes | None) -> str:
    return output.decode(errors="replace") if isinstance(output, bytes) else output or ""


def _probe() -> int:
    """Run the steps and tell of each at once, so that what was done before an abort is known."""
    from sfsnet_dr.render import probe

    for name in STEPS:
        try:
            detail, values = probe.STEPS[name]()
            check = Check(name, True, detail, values)
        except Exception as error:  # a diagnosis reports whatever a library raises
            lines = str(error).strip().splitlines() or ["no message"]
            check = Check(name, False, f"{type(error).__name__}: {lines[-1]}")
        print(json.dumps(asdict(check)), flush=True)
    return 0


if __name__ == "__main__":
    if sys.argv[1:] != ["--probe"]:
        sys.exit("This file is run by `sfsnet-dr doctor`; use that command.")
    sys.exit(_probe())
