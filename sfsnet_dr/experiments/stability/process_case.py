"""What a case is that needs a process of its own: many calls, threads, forks, sizes out of bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """What a case found out about one form.

    Attributes:
        figure: the number that was bounded, or the number of results compared.
        problem: why the case failed; empty where it passed.
        refused: the line of the InputError, where one was expected.
    """

    figure: float
    problem: str = ""
    refused: str = ""


@dataclass(frozen=True)
class ProcessCase:
    """A case that runs in a child with a time limit.

    Attributes:
        name: what is hard about it.
        expected: bound or error, for the page.
        cause: why that is expected, for the page.
        work: takes the name of a form; imports what it needs itself, so that a fork can come first.
        unit: unit of the figure.
        jit_only: whether it is about Dr.Jit alone.
        differentiable_only: whether it needs gradients.
        alone: whether each form needs a process in which no other has run.
        limit: seconds after which a form counts as hanging.
    """

    name: str
    expected: str
    cause: str
    work: Callable[[str], Finding]
    unit: str = "results"
    jit_only: bool = False
    differentiable_only: bool = False
    alone: bool = False
    limit: float = 240.0
