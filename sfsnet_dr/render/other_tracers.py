"""Path tracers that need a process of their own: Mitsuba's other variants, and Cycles.

Mitsuba's variant belongs to a whole process. Cycles comes with Blender (``bpy``), under the GPL and with an
older NumPy: it lives in an environment of its own that ``make cycles`` sets up, and only files pass between.
"""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Final

from sfsnet_dr.base.checks import NotInstalled
from sfsnet_dr.render.remote import Command, RemoteRenderer, our_python
from sfsnet_dr.render.renderer import Capabilities

#: Names a Python that can import ``bpy``, where it is not in ``.venv-cycles``.
CYCLES_VARIABLE: Final = "SFSNET_DR_CYCLES_PYTHON"

#: What installs it, in a checkout.
CYCLES_COMMAND: Final = "make cycles"

_ENVIRONMENT = Path(".venv-cycles")
_SCRIPT = Path(__file__).with_name("cycles_script.py")
_VARIANTS = {"mitsuba-scalar": "scalar_rgb", "mitsuba-spectral": "llvm_ad_spectral"}


def make(tracer: str, depth: str, bounces: int) -> RemoteRenderer:
    """A renderer by the two parts of its name; all of them leave gloss out."""
    capabilities = Capabilities(visibility=True, bounces=bounces, noisy=True)
    command = cycles_command if tracer == "cycles" else partial(_mitsuba_command, _VARIANTS[tracer])
    return RemoteRenderer(f"{tracer}-{depth}", capabilities, command)


def cycles_python() -> Path:
    """The Python of Blender's environment.

    It is named by the environment variable, or lies in ``.venv-cycles`` of this checkout or of the current
    folder.

    Raises:
        NotInstalled: if there is none, or ``make cycles`` has not finished.
    """
    named = os.environ.get(CYCLES_VARIABLE)
    if named:
        if Path(named).is_file():
            return Path(named)
        raise NotInstalled(f"cycles: not installed ({CYCLES_VARIABLE}={named} is no file): {CYCLES_COMMAND}")
    checkout = Path(__file__).resolve().parent.parent.parent
    for folder in (checkout / _ENVIRONMENT, Path.cwd() / _ENVIRONMENT):
        if (folder / ".ready").is_file():
            return folder / "bin" / "python"
    raise NotInstalled(f"cycles: not installed (no {_ENVIRONMENT} here): {CYCLES_COMMAND}")


def cycles_version() -> str:
    """Version of ``bpy``, as far as it can be read without starting it.

    Raises:
        NotInstalled: as ``cycles_python``.
    """
    environment = cycles_python().parent.parent
    found = sorted(environment.glob("lib/python*/site-packages/bpy-*.dist-info"))
    return found[0].name.split("-")[1].removesuffix(".dist") if found else "of unknown version"


def cycles_command() -> Command:
    """The script inside Blender's environment."""
    # Neither our packages nor a user's Blender settings may get into it.
    clean = {"PYTHONPATH": "", "PYTHONNOUSERSITE": "1", "BLENDER_USER_RESOURCES": os.devnull}
    return (str(cycles_python()), str(_SCRIPT)), clean


def _mitsuba_command(variant: str) -> Command:
    return our_python("-m", "sfsnet_dr.render.mitsuba_child", variant)
