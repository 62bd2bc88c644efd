"""Keeps what follows from a head's regions alone, so that each person costs only what is the person's own."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

from sfsnet_dr.scene.faces.regions import RegionWeights

T = TypeVar("T")


def cached_per_head(make: Callable[[RegionWeights], T]) -> Callable[[RegionWeights], T]:
    """Call ``make`` once for each ``RegionWeights`` and keep the result while those live.

    The weights are told apart by identity: they hold arrays, which have no hash.
    """
    kept: dict[int, tuple[weakref.ref[RegionWeights], T]] = {}

    @wraps(make)
    def look_up(weights: RegionWeights) -> T:
        key = id(weights)
        known = kept.get(key)
        if known is None or known[0]() is not weights:
            known = weakref.ref(weights, lambda _: kept.pop(key, None)), make(weights)
            kept[key] = known
        return known[1]

    return look_up
