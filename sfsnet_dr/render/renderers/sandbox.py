"""Other people's renderers may raise, hang, abort or give what is no image: that becomes a described failure.

Our own renderers run in this process. Every other one runs in a process of its own, which is ended when time
is up, so that nothing it does can keep the rest of a comparison from going on.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from sfsnet_dr.core.errors import NotInstalled
from sfsnet_dr.core.worker_process import Answer, WorkerFailed, WorkerProcess, one_line, serve
from sfsnet_dr.render.renderers.base import Budget, Capabilities, Image, Renderer
from sfsnet_dr.render.renderers.registry import find_renderer, is_built_in, renderers
from sfsnet_dr.render.renderers.remote import (
    light_folder,
    our_python,
    read_light,
    read_subject,
    subject_folder,
)
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.subject import Subject

#: Seconds that one image may take, the start of the process included.
TIME_LIMIT: Final = 120.0

Kind = Literal["not installed", "raised", "hung", "died", "no image"]


@dataclass(frozen=True)
class Failure:
    """Why there is no image.

    Attributes:
        kind: a word to count by.
        detail: one line to read.
    """

    kind: Kind
    detail: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.detail}"


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one image.

    Attributes:
        renderer: its name.
        image: (H, W, 3), finite, float32 or float64; None after a failure.
        seconds: of rendering alone, or until the failure.
        capabilities: what the renderer says of itself; None if it did not come to that.
        failure: None if there is an image.
    """

    renderer: str
    image: Image | None
    seconds: float
    capabilities: Capabilities | None
    failure: Failure | None


_children: dict[str, WorkerProcess] = {}


def run_sandboxed(
    name: str, subject: Subject, light: Light, budget: Budget, time_limit: float = TIME_LIMIT
) -> Outcome:
    """Render with a renderer that may fail in any way.

    Args:
        name: of the renderer.
        subject: what is looked at.
        light: what lights it.
        budget: what it may spend.
        time_limit: seconds; our own renderers are not held to it.

    Raises:
        InputError: for a name that nobody has.
    """
    if is_built_in(name):
        return _here(name, subject, light, budget)
    if name not in renderers():
        find_renderer(name)  # tells the nearest name
    return _apart(name, subject, light, budget, time_limit)


def invalid_image_reason(image: Any, size: int) -> str | None:
    """Why something is no image of a size, in one line; None if it is one."""
    if not isinstance(image, np.ndarray):
        return f"{type(image).__name__} found, a NumPy array (H, W, 3) expected"
    if image.dtype not in (np.float32, np.float64):
        return f"dtype {image.dtype} found, float32 or float64 expected"
    if image.shape != (size, size, 3):
        return f"shape {image.shape} found, ({size}, {size}, 3) expected"
    wrong = int(np.count_nonzero(~np.isfinite(image)))
    return f"{wrong} of {image.size} values are NaN or inf, finite ones expected" if wrong else None


def _here(name: str, subject: Subject, light: Light, budget: Budget) -> Outcome:
    begin, capabilities = time.perf_counter(), None
    try:
        renderer = find_renderer(name)
        capabilities = renderer.capabilities
        image = renderer.render(subject, light, budget)
        wrong = invalid_image_reason(image, subject.camera.size)
        failure = Failure("no image", wrong) if wrong else None
    except NotInstalled as missing:
        failure = Failure("not installed", str(missing))
    except Exception as error:  # the rest of a comparison goes on, whatever it was
        failure = Failure("raised", one_line(error))
    seconds = time.perf_counter() - begin
    return Outcome(name, None if failure else image, seconds, capabilities, failure)


def _apart(name: str, subject: Subject, light: Light, budget: Budget, time_limit: float) -> Outcome:
    begin = time.perf_counter()

    def failed(kind: Kind, detail: str, capabilities: Capabilities | None = None) -> Outcome:
        return Outcome(name, None, time.perf_counter() - begin, capabilities, Failure(kind, detail))

    with tempfile.TemporaryDirectory(prefix="sfsnet_dr-") as folder:
        out = Path(folder) / "image.npy"
        question = {
            "subject": str(subject_folder(subject)),
            "light": str(light_folder(light)),
            "budget": asdict(budget),
            "out": str(out),
        }
        try:
            answer = _child(name).ask(question, time_limit)
        except WorkerFailed as end:
            return failed(end.how, str(end))
        capabilities = Capabilities(**answer["capabilities"]) if "capabilities" in answer else None
        if "error" in answer:
            return failed(answer.get("failure", "raised"), answer["error"], capabilities)
        image = np.load(out, allow_pickle=False)
    return Outcome(name, image, float(answer["seconds"]), capabilities, None)


def _child(name: str) -> WorkerProcess:
    child = _children.get(name)
    if child is None or not child.alive:
        command, environment = our_python("-m", "sfsnet_dr.render.renderers.sandbox", name)
        child = _children[name] = WorkerProcess(command, environment)
    return child


def _answering(name: str) -> Callable[[Answer], Answer]:
    """The other side: answers questions of ``_apart`` with one renderer."""
    known: dict[str, Renderer] = {}
    subjects: dict[str, Subject] = {}

    def answer(question: Answer) -> Answer:
        if name not in known:
            known[name] = find_renderer(name)
        said: Answer = {"capabilities": asdict(known[name].capabilities)}
        if question["subject"] not in subjects:
            subjects.clear()
            subjects[question["subject"]] = read_subject(Path(question["subject"]))
        subject, light = subjects[question["subject"]], read_light(Path(question["light"]))
        begin = time.perf_counter()
        try:
            image = known[name].render(subject, light, Budget(**question["budget"]))
        except Exception as error:  # told together with what the renderer says of itself
            return {**said, "error": one_line(error)}
        said["seconds"] = time.perf_counter() - begin
        wrong = invalid_image_reason(image, subject.camera.size)
        if wrong:
            return {**said, "error": wrong, "failure": "no image"}
        np.save(question["out"], image, allow_pickle=False)
        return said

    return answer


if __name__ == "__main__":
    serve(_answering(sys.argv[1]))
