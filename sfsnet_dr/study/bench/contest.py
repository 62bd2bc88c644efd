"""Times of several contenders, taken in turns so that a machine that slows down slows all of them."""

from __future__ import annotations

import shutil
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import torch

#: Calls in a row of one contender before the next has its turn, and for how many seconds at least; the
#: fastest counts. At first, threads of the contender before still wait for work in a loop that keeps a
#: core busy, which takes some milliseconds: many calls, where they are short.
IN_A_ROW: Final = 3
TURN_SECONDS: Final = 0.03

#: Bytes of each buffer for the copy bandwidth: beyond any cache.
COPY_BYTES: Final = 256 * 2**20


@dataclass(frozen=True)
class Times:
    """Seconds of one contender, one number a round."""

    rounds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Seconds."""
        return statistics.median(self.rounds)

    def interval(self) -> tuple[float, float]:
        """Second smallest and second largest round; of fewer than four, the smallest and the largest."""
        ordered = sorted(self.rounds)
        if len(ordered) >= 4:
            ordered = ordered[1:-1]
        return ordered[0], ordered[-1]

    def ratio(self, to: Times) -> tuple[float, tuple[float, float]]:
        """How many times as long the other takes: median over the rounds, and second smallest and largest."""
        ratios = Times(tuple(b / a for a, b in zip(self.rounds, to.rounds, strict=True)))
        return ratios.median, ratios.interval()

    def share(self, copy: Times, traffic: int) -> tuple[float, tuple[float, float]]:
        """``ratio`` to what copying ``traffic`` bytes would take at the bandwidth of a ``bandwidth_copy``."""
        scale = traffic / (2 * COPY_BYTES)
        ratio, (low, high) = self.ratio(copy)
        return scale * ratio, (scale * low, scale * high)


def contest(contenders: Mapping[str, Callable[[], Any]], rounds: int) -> dict[str, Times]:
    """Time every contender in every round, after two calls that may compile.

    Args:
        contenders: what to call, by name.
        rounds: how many times each has its turn.
    """
    for call in contenders.values():
        call()
        call()
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, call in contenders.items():
            seconds[name].append(_turn(call))
    return {name: Times(tuple(found)) for name, found in seconds.items()}


def copier(traffic: int) -> Callable[[], Any]:
    """What copies as many bytes as make ``traffic`` bytes read and written."""
    source = torch.ones(max(traffic // 8, 1))
    target = torch.empty_like(source)
    return lambda: target.copy_(source)


def bandwidth_copy() -> Callable[[], Any]:
    """What shows the copy bandwidth of the moment: ``COPY_BYTES`` read and as many written."""
    return copier(2 * COPY_BYTES)


def bytes_a_second(copy: Times) -> float:
    """The bandwidth that a ``bandwidth_copy`` showed, bytes read and written a second."""
    return 2 * COPY_BYTES / copy.median


def compiler_missing() -> str | None:
    """Why torch.compile cannot be measured here, or None."""
    if not any(shutil.which(name) for name in ("g++", "clang++", "c++")):
        return "no C++ compiler was found, which torch.compile needs"
    return None


def _turn(call: Callable[[], Any]) -> float:
    found: list[float] = []
    while len(found) < IN_A_ROW or sum(found) < TURN_SECONDS:
        found.append(_seconds(call))
    return min(found)


def _seconds(call: Callable[[], Any]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start
