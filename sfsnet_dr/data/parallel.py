"""One function over many seeds, in this process, in a crew of local processes, or on Ray.

All three give the same answers, each as soon as it is there. A worker that dies ends the run with one line
that says which seed it had: what was finished before is the caller's to keep.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Final, Protocol, TypeVar

from sfsnet_dr.core import runtime
from sfsnet_dr.core.errors import InputError, RunError

T = TypeVar("T")

#: Seeds after which a process is replaced: thousands of renders in one process have been seen to hang.
LIFETIME: Final = 200


class Workers(Protocol):
    """A way to run one function on many seeds."""

    def run(self, work: Callable[[int], T], seeds: Sequence[int]) -> Iterator[tuple[int, T]]:
        """Seeds with their answers, in the order in which they are finished.

        Args:
            work: a function that other processes can import, or a ``functools.partial`` of one.
            seeds: all different.

        Raises:
            RunError: if a worker dies.
            Exception: what ``work`` raised; of several failures the first.
        """
        ...


def choose_workers(count: int, tasks: int, ray: str | None = None, *, lifetime: int = LIFETIME) -> Workers:
    """The way to run ``tasks`` seeds on ``count`` workers.

    One worker that need not be replaced is this process itself.

    Args:
        count: workers side by side, at least 1.
        tasks: number of seeds.
        ray: None for processes of this machine; ``"local"`` for Ray on this machine; else the address of a
            running Ray cluster.
        lifetime: seeds after which a process is replaced.
    """
    if ray is not None:
        return RayWorkers(ray, count, lifetime)
    if count == 1 and tasks <= lifetime:
        return InProcess()
    return ProcessPool(min(count, max(tasks, 1)), lifetime)


class InProcess:
    """No worker but this process."""

    def run(self, work: Callable[[int], T], seeds: Sequence[int]) -> Iterator[tuple[int, T]]:
        """See ``Workers.run``."""
        for seed in seeds:
            yield seed, work(seed)


class ProcessPool:
    """Fresh processes on this machine, which end with this one, whatever ends it.

    Args:
        count: processes side by side; they share the machine's cores.
        lifetime: seeds after which a process is replaced.
    """

    def __init__(self, count: int, lifetime: int = LIFETIME) -> None:
        self._count, self._lifetime = count, lifetime
        self._threads = threads_each(count)

    def run(self, work: Callable[[int], T], seeds: Sequence[int]) -> Iterator[tuple[int, T]]:
        """See ``Workers.run``."""
        waiting = deque(seeds)
        crew: dict[Connection, _Member] = {}
        try:
            while waiting or crew:
                while waiting and len(crew) < self._count:
                    member = _Member.hired(work, self._threads, min(self._lifetime, len(waiting)))
                    crew[member.connection] = member
                    member.give(waiting.popleft())
                for connection in _ready(crew):
                    member = crew[connection]
                    seed, answer = member.answer()
                    if member.left and waiting:
                        member.give(waiting.popleft())
                    else:
                        crew.pop(connection).dismiss()
                    yield seed, answer
        finally:
            for member in crew.values():
                member.process.kill()
            for member in crew.values():
                member.dismiss()


@dataclass
class _Member:
    process: SpawnProcess
    connection: Connection
    left: int  # seeds until it is replaced
    seed: int = -1

    @classmethod
    def hired(cls, work: Callable[[int], Any], threads: int, lifetime: int) -> _Member:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, work, threads), daemon=True)
        process.start()
        theirs.close()  # so that the end of the process is seen as the end of the pipe
        return cls(process, ours, lifetime)

    def give(self, seed: int) -> None:
        self.seed, self.left = seed, self.left - 1
        try:
            self.connection.send(seed)
        except OSError as error:
            raise self._died() from error

    def answer(self) -> tuple[int, Any]:
        try:
            answer = self.connection.recv()
        except (EOFError, OSError) as error:
            raise self._died() from error
        if isinstance(answer, Exception):
            raise answer
        return self.seed, answer

    def dismiss(self) -> None:
        self.connection.close()  # what its loop takes as the end
        self.process.join()

    def _died(self) -> RunError:
        self.process.join()
        return RunError(f"seed {self.seed}: its worker process died ({_end(self.process.exitcode)})")


def _serve(connection: Connection, work: Callable[[int], Any], threads: int) -> None:
    """The life of a worker process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt reaches the whole group; the parent decides
    threading.Thread(target=_end_with_parent, daemon=True).start()
    runtime.set_threads(threads)
    try:
        while True:
            connection.send(_outcome(work, connection.recv()))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return


def _outcome(work: Callable[[int], T], seed: int) -> T | Exception:
    try:
        return work(seed)
    except (InputError, RunError) as error:
        return error
    except Exception as error:
        error.add_note(f"In a worker process, seed {seed}:\n{traceback.format_exc()}")
        return error


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def _ready(crew: Iterable[Connection]) -> list[Connection]:
    return [c for c in wait(list(crew)) if isinstance(c, Connection)]


def _end(code: int | None) -> str:
    if code is None or code >= 0:
        return f"exit code {code}"
    name = signal.Signals(-code).name
    return f"{name}; out of memory?" if name == "SIGKILL" else name


def threads_each(count: int) -> int:
    """Threads for each of ``count`` processes on this machine."""
    return max(1, (os.cpu_count() or 1) // count)


class RayWorkers:
    """Tasks of Ray (extra ``distributed``).

    The functions must be importable and files that they read must be found under the same names on all
    machines of the cluster.

    Args:
        address: ``"local"`` starts Ray on this machine's loopback interface and ends it with the run;
            anything else is a running cluster's address.
        count: tasks at a time.
        lifetime: seeds after which a process of Ray is replaced.

    Raises:
        InputError: without Ray, or where none answers at the address.
    """

    def __init__(self, address: str, count: int, lifetime: int = LIFETIME) -> None:
        if find_spec("ray") is None:
            raise InputError(
                "--ray: Ray is not installed; run `pip install 'sfsnet_dr[distributed]'` or leave --ray out"
            )
        if address != "local":
            _check_address(address)
        self._address, self._count, self._lifetime = address, count, lifetime

    def run(self, work: Callable[[int], T], seeds: Sequence[int]) -> Iterator[tuple[int, T]]:
        """See ``Workers.run``."""
        ray = _module()
        waiting = deque(seeds)
        with _ray(self._address, self._count):
            threads = threads_each(self._count) if self._address == "local" else 1
            task = ray.remote(num_cpus=1, max_calls=self._lifetime, max_retries=0)(_task)
            shared = ray.put((work, threads))
            running: dict[Any, int] = {}
            while waiting or running:
                while waiting and len(running) < self._count:
                    seed = waiting.popleft()
                    running[task.remote(shared, seed)] = seed
                for reference in ray.wait(list(running))[0]:
                    seed = running.pop(reference)
                    yield seed, _fetch(reference, seed)


def _module() -> Any:
    return import_module("ray")  # an extra, so that no type checker can count on it


def _task(shared: tuple[Callable[[int], Any], int], seed: int) -> Any:
    work, threads = shared
    runtime.set_threads(threads)
    return _outcome(work, seed)


def _fetch(reference: Any, seed: int) -> Any:
    ray = _module()
    try:
        answer = ray.get(reference)
    except ray.exceptions.RayError as error:
        raise RunError(f"seed {seed}: its Ray worker failed ({type(error).__name__})") from error
    if isinstance(answer, Exception):
        raise answer
    return answer


@contextmanager
def _ray(address: str, count: int) -> Iterator[None]:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # sends nothing about its use anywhere
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # its future default; else it warns
    ray = _module()
    local: dict[str, Any] = {
        "num_cpus": count,
        "include_dashboard": False,
        "_node_ip_address": "127.0.0.1",
        "runtime_env": {"env_vars": {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}},
    }
    handler = signal.getsignal(signal.SIGTERM)  # Ray puts its own in its place
    try:
        ray.init(address, log_to_driver=False, logging_level="ERROR", **(local if address == "local" else {}))
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise InputError(_no_ray(address, str(error).partition("\n")[0])) from error
    try:
        yield
    finally:
        ray.shutdown()
        signal.signal(signal.SIGTERM, handler)


def _check_address(address: str) -> None:
    """Ray itself would wait for minutes for a cluster that is not there."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=10).close()
    except (OSError, ValueError) as error:
        raise InputError(_no_ray(address, str(error))) from error


def _no_ray(address: str, reason: str) -> str:
    return f"--ray {address}: no Ray found there ({reason}); give 'local' or HOST:PORT of a running head"
