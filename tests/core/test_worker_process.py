"""Processes that answer questions: each way in which one may fail to."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import sfsnet_dr
from sfsnet_dr.core.worker_process import WorkerFailed, WorkerProcess

#: Answers with the result of the Python expression that it is asked.
PROGRAM = """
import os, subprocess, sys, time
from sfsnet_dr.core.worker_process import serve
serve(lambda question: {"found": eval(question["what"])})
"""


@pytest.fixture
def child() -> Iterator[WorkerProcess]:
    root = str(Path(sfsnet_dr.__file__).parent.parent)
    made = WorkerProcess([sys.executable, "-c", PROGRAM], {"PYTHONPATH": root})
    yield made
    made.end()


def ask(child: WorkerProcess, what: str, seconds: float = 30.0) -> object:
    answer = child.ask({"what": what}, seconds)
    return answer.get("found", answer.get("error"))


def gone(process: object) -> bool:
    """Whether a process has ended; one that nobody has asked for its exit code still has a number."""
    try:
        return Path(f"/proc/{process}/stat").read_text().split()[2] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def test_it_answers_and_what_it_prints_is_no_answer(child: WorkerProcess) -> None:
    assert ask(child, "1 + 1") == 2
    assert ask(child, "print('{}') or os.system('echo {}')") == 0
    assert ask(child, "'x' * 300000") == "x" * 300000
    assert ask(child, "1 / 0") == "ZeroDivisionError: division by zero"
    assert ask(child, "2") == 2


def test_one_that_hangs_is_ended_with_what_it_started(child: WorkerProcess) -> None:
    number = ask(child, "subprocess.Popen(['sleep', '600']).pid")
    with pytest.raises(WorkerFailed, match=r"no answer within 0\.2 s; the process was ended") as failed:
        ask(child, "time.sleep(600)", 0.2)
    assert failed.value.how == "hung"
    assert not child.alive
    deadline = time.monotonic() + 30  # a killed process goes when it next has a turn on the processor
    while not gone(number) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert gone(number)


def test_one_that_dies_is_told_by_its_last_words(child: WorkerProcess) -> None:
    with pytest.raises(WorkerFailed, match="exit code 3: goodbye") as failed:
        ask(child, "print('goodbye', flush=True) or os._exit(3)")
    assert failed.value.how == "died"


def test_one_that_is_gone_says_so(child: WorkerProcess) -> None:
    ask(child, "1")
    child._process.kill()
    child._process.wait()
    with pytest.raises(WorkerFailed, match="SIGKILL, and said nothing"):
        ask(child, "x" * 1000)
