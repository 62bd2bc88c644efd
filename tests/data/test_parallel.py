"""Workers: the same answers wherever they run, replaced in time, and a death told in one line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest

from sfsnet_dr.core.errors import InputError, RunError
from sfsnet_dr.data import parallel
from sfsnet_dr.data.parallel import LIFETIME, InProcess, ProcessPool, RayWorkers, choose_workers

ray_is_here = pytest.mark.skipif(find_spec("ray") is None, reason="the extra `distributed` is not installed")


def square(seed: int) -> int:
    return seed * seed


def process(seed: int) -> int:
    return os.getpid()


def end(how: str, seed: int) -> int:
    if seed == 2 and how == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if seed == 2 and how == "left":
        os._exit(3)
    if seed == 2 and how == "bad":
        raise InputError("map.exr: 0 bytes found")
    if seed == 2 and how == "bug":
        raise KeyError("surface")
    return seed


def test_a_crew_answers_as_this_process_does() -> None:
    seeds = range(3, 9)
    assert list(InProcess().run(square, seeds)) == [(k, k * k) for k in seeds]
    assert sorted(ProcessPool(2).run(square, seeds)) == [(k, k * k) for k in seeds]
    assert list(ProcessPool(2).run(square, [])) == []


def test_processes_are_replaced() -> None:
    shares = Counter(pid for _, pid in ProcessPool(1, lifetime=2).run(process, range(5)))
    assert os.getpid() not in shares
    assert sorted(shares.values()) == [1, 2, 2]


def test_a_long_run_replaces_its_processes_unasked() -> None:
    """As ``synth --count 450`` would: one worker, but not this process, and none does more than its share."""
    shares = Counter(pid for _, pid in choose_workers(1, 450).run(process, range(450)))
    assert os.getpid() not in shares
    assert sorted(shares.values()) == [50, LIFETIME, LIFETIME]


@pytest.mark.parametrize(
    ("how", "kind", "words"),
    [
        ("killed", RunError, r"seed 2: its worker process died \(SIGKILL; out of memory\?\)"),
        ("left", RunError, r"seed 2: its worker process died \(exit code 3\)"),
        ("bad", InputError, "map.exr: 0 bytes found"),
        ("bug", KeyError, "surface"),
    ],
)
def test_a_failure_says_which_seed_and_why(how: str, kind: type[Exception], words: str) -> None:
    answers: list[tuple[int, int]] = []
    with pytest.raises(kind, match=words) as caught:
        answers.extend(ProcessPool(1).run(partial(end, how), [0, 1, 2, 3]))
    assert answers == [(0, 0), (1, 1)]  # what came before is not lost
    if how == "bug":
        [note] = caught.value.__notes__
        assert "seed 2" in note
        assert 'raise KeyError("surface")' in note


def test_workers_end_with_their_parent() -> None:
    """A worker that went on alone would write into a folder that a resumed run is sweeping."""
    code = "import time, sys, data.test_parallel as t; list(t.ProcessPool(1).run(t.tell_and_sleep, [0]))"
    parent = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ
        | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), *filter(None, sys.path)])},
    )
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    assert alive(child)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    deadline = time.monotonic() + 20
    while alive(child) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not alive(child)


def tell_and_sleep(seed: int) -> int:
    print(os.getpid(), flush=True)
    time.sleep(60)
    return seed


def alive(pid: int) -> bool:
    """Whether a process runs; one that only waits to be collected does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_one_worker_is_this_process_while_it_need_not_be_replaced() -> None:
    assert isinstance(choose_workers(1, 5, lifetime=5), InProcess)
    assert isinstance(choose_workers(1, 6, lifetime=5), ProcessPool)
    assert isinstance(choose_workers(2, 5), ProcessPool)


def test_without_ray_the_line_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "find_spec", lambda name: None)
    with pytest.raises(
        InputError, match=r"Ray is not installed; run `pip install 'sfsnet_dr\[distributed\]'`"
    ):
        choose_workers(1, 1, "local")


@ray_is_here
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
class TestOnRay:
    def test_it_answers_as_this_process_does(self) -> None:
        seeds = range(4)
        answers = dict(RayWorkers("local", 2, lifetime=2).run(square, seeds))
        assert answers == {k: k * k for k in seeds}

    def test_processes_are_replaced(self) -> None:
        shares = Counter(pid for _, pid in RayWorkers("local", 1, lifetime=2).run(process, range(4)))
        assert max(shares.values()) <= 2

    @pytest.mark.parametrize(
        ("how", "kind", "words"),
        [("killed", RunError, "seed 2: its Ray worker"), ("bad", InputError, "map.exr: 0 bytes found")],
    )
    def test_a_failure_says_which_seed(self, how: str, kind: type[Exception], words: str) -> None:
        with pytest.raises(kind, match=words):
            list(RayWorkers("local", 1).run(partial(end, how), [0, 1, 2, 3]))

    def test_an_address_without_ray_is_bad_input(self) -> None:
        with pytest.raises(InputError, match=r"--ray 127\.0\.0\.1:1: no Ray found there"):
            list(RayWorkers("127.0.0.1:1", 1).run(square, [0]))
