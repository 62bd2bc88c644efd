"""Processes that answer questions: one line of JSON in, one line of JSON out.

A program that may hang, abort or need other libraries than ours runs in one, and can be ended.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from typing import IO, Any, Literal

Answer = dict[str, Any]


class WorkerFailed(Exception):
    """The process gave no answer.

    Attributes:
        how: ``hung`` if time ran out, ``died`` if it ended.
    """

    def __init__(self, how: Literal["hung", "died"], reason: str) -> None:
        super().__init__(reason)
        self.how = how


class WorkerProcess:
    """A process that is asked one question at a time; it ends with this object, or when it fails.

    Args:
        command: a program that ends when its standard input does, such as one that calls ``serve``.
        environment: variables in addition to this process's.
    """

    def __init__(self, command: Sequence[str], environment: Mapping[str, str] | None = None) -> None:
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 (closed when the process ends)
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            env={**os.environ, **(environment or {})},
            start_new_session=True,  # so that it can be ended with all that it has started
        )
        self._rest = b""
        self._end = weakref.finalize(self, _end, self._process, self._said)

    @property
    def alive(self) -> bool:
        """Whether it can be asked."""
        return self._end.alive and self._process.poll() is None

    def ask(self, question: Mapping[str, Any], time_limit: float) -> Answer:
        """Put a question and wait for its answer.

        Args:
            question: JSON values by name.
            time_limit: seconds; after that the process is ended.

        Raises:
            ChildFailed: if time ran out or the process ended. It cannot be asked again.
        """
        try:
            return self._ask(json.dumps(question).encode() + b"\n", time_limit)
        except BaseException:
            self.end()
            raise

    def end(self) -> None:
        """End the process at once, with all that it has started."""
        self._end()

    def _ask(self, line: bytes, time_limit: float) -> Answer:
        assert self._process.stdin is not None
        deadline = time.monotonic() + time_limit
        try:
            self._process.stdin.write(line)
            self._process.stdin.flush()
        except BrokenPipeError:
            raise self._died() from None
        while b"\n" not in self._rest:
            self._rest += self._read(deadline, time_limit)
        answer, self._rest = self._rest.split(b"\n", 1)
        found: Answer = json.loads(answer)
        return found

    def _read(self, deadline: float, time_limit: float) -> bytes:
        assert self._process.stdout is not None
        ready, _, _ = select.select([self._process.stdout], [], [], max(0.0, deadline - time.monotonic()))
        if not ready:
            raise WorkerFailed("hung", f"no answer within {time_limit:g} s; the process was ended")
        part = os.read(self._process.stdout.fileno(), 1 << 16)
        if not part:
            raise self._died()
        return part

    def _died(self) -> WorkerFailed:
        code = self._process.wait()
        self._said.seek(0)
        return WorkerFailed("died", end_reason(code, self._said.read().decode(errors="replace")))


def serve(answer: Callable[[Answer], Answer]) -> None:
    """Answer questions until there are no more; the body of a child written in Python.

    What libraries print goes to standard error. An exception becomes the answer ``{"error": ...}``.
    """
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answers:
        os.dup2(2, 1)
        for line in sys.stdin:
            try:
                said = answer(json.loads(line))
            except Exception as error:  # whatever a renderer raises is told, not lost
                said = {"error": one_line(error), "kind": type(error).__name__}
            print(json.dumps(said), file=answers, flush=True)


def one_line(error: BaseException) -> str:
    """An exception as one line: its type, and the last line of its message."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return f"{type(error).__name__}: {lines[-1] if lines else 'no message'}"


def end_reason(returncode: int, stderr: str, when: str = "") -> str:
    """How a process ended, with its last line on standard error."""
    lines = [line.strip() for line in stderr.splitlines() if line.strip()]
    last = f": {lines[-1]}" if lines else ", and said nothing"
    if returncode < 0:
        return f"the process was ended by {_signal_name(-returncode)}{last}"
    return f"the process ended with exit code {returncode}{when}{last}"


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _end(process: subprocess.Popen[bytes], said: IO[bytes]) -> None:
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    for stream in (process.stdin, process.stdout, said):
        if stream is not None:
            try:
                stream.close()
            except BrokenPipeError:
                continue  # a question that nobody read
