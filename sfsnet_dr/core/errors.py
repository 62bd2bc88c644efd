"""Errors that end a command with one clear line, and shape checks with named dimensions."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any


class InputError(ValueError):
    """The caller's input is wrong. Commands print its one line and exit with code 2."""


class NotInstalled(InputError):
    """Something optional is missing; the line ends in the command that installs it."""


class RunError(RuntimeError):
    """The work itself failed on good input. Commands print its one line and exit with code 1."""


def check_shape(name: str, array: Any, pattern: str, **known: int) -> dict[str, int]:
    """Match an array's shape against named dimensions.

    Args:
        name: the argument's name, for the message.
        array: anything with a ``shape``.
        pattern: dimensions separated by spaces, each a number or a name: ``"B 3 H W"``.
        known: sizes that named dimensions must have, for example from an earlier check.

    Returns:
        The size of every named dimension, ``known`` included.

    Raises:
        InputError: naming the argument, the shape found and the pattern allowed.
    """
    shape = tuple(map(int, array.shape))
    dims = [int(dim) if dim.isdigit() else dim for dim in pattern.split()]
    sizes = dict(known)
    matches = len(dims) == len(shape)
    for dim, size in zip(dims, shape, strict=False):
        want = dim if isinstance(dim, int) else sizes.setdefault(dim, size)
        matches = matches and want == size
    if not matches:
        where = f" with {', '.join(f'{k}={v}' for k, v in known.items())}" if known else ""
        raise InputError(f"{name}: shape {shape} found, ({', '.join(map(str, dims))}){where} expected")
    return sizes


def nearest(word: str, allowed: Iterable[str]) -> str:
    """The end of an error message: the nearest allowed word if one is close, else all of them."""
    words = sorted(allowed)
    close = difflib.get_close_matches(word, words, n=1)
    return f"did you mean {close[0]!r}?" if close else f"allowed: {', '.join(words)}"
