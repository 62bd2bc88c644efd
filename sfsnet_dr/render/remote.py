"""Renderers that run in a process of their own: another Mitsuba variant, or Blender's Cycles."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from sfsnet_dr.base.checks import WorkFailed
from sfsnet_dr.base.child import Child, ChildFailed
from sfsnet_dr.render.exchange import light_folder, subject_folder
from sfsnet_dr.render.renderer import Budget, Capabilities, Image
from sfsnet_dr.scene.lights import SceneLight
from sfsnet_dr.scene.subject import Subject

#: Seconds that one image may take.
TIME_LIMIT: Final = 1800.0

Command = tuple[tuple[str, ...], Mapping[str, str]]

_children: dict[tuple[str, ...], Child] = {}


class RemoteRenderer:
    """A renderer behind a process that is started once and kept.

    Args:
        name: for tables.
        capabilities: what it accounts for.
        command: gives the program and its environment when the first image is asked for. The program takes
            questions of ``subject`` and ``light`` (folders of ``render.exchange``), ``samples``, ``seed``,
            ``bounces`` and ``out``, and writes an image (H, W, 3), float32, to ``out``.
    """

    def __init__(self, name: str, capabilities: Capabilities, command: Callable[[], Command]) -> None:
        self.name, self.capabilities = name, capabilities
        self._command = command

    def render(self, subject: Subject, light: SceneLight, budget: Budget) -> Image:
        """An image (H, W, 3), float32.

        Raises:
            NotInstalled: if the program is missing.
            WorkFailed: if it gave no image.
        """
        child = self._child()
        with tempfile.TemporaryDirectory(prefix="sfsnet_dr-") as folder:
            out = Path(folder) / "image.npy"
            question = {
                "subject": str(subject_folder(subject)),
                "light": str(light_folder(light)),
                "samples": budget.samples,
                "seed": budget.seed,
                "bounces": self.capabilities.bounces,
                "out": str(out),
            }
            try:
                answer = child.ask(question, TIME_LIMIT)
            except ChildFailed as failed:
                raise WorkFailed(f"{self.name}: {failed}") from failed
            if "error" in answer:
                raise WorkFailed(f"{self.name}: {answer['error']}")
            image: Image = np.load(out, allow_pickle=False)
            return image

    def _child(self) -> Child:
        command, environment = self._command()
        child = _children.get(command)
        if child is None or not child.alive:
            child = _children[command] = Child(command, environment)
        return child


def our_python(*arguments: str) -> Command:
    """A module of ours, in a Python that finds the same packages as this one."""
    return (sys.executable, *arguments), {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
