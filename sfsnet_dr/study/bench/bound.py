"""What a time is bound by, in words, from the time of its kernels and of a copy."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Any, Final

from sfsnet_dr.render.drjit_bridge import kernel_milliseconds

#: Calls whose kernels are timed.
REPEATS: Final = 9


def bound(call: Callable[[], Any], seconds: float, copy_seconds: float) -> str:
    """One sentence on what keeps a call from being faster.

    Args:
        call: what was timed.
        seconds: its time.
        copy_seconds: the time in which its bytes could be copied.
    """
    kernels = statistics.median(kernel_milliseconds(call) for _ in range(REPEATS)) / 1000
    outside = max(seconds - kernels, 0)
    parts = {"kernels": kernels, "outside of them": outside, "memory": copy_seconds}
    text = ", ".join(f"{name} {1e3 * part:.2f} ms" for name, part in parts.items())
    if outside > kernels:
        return f"{text}: bound by the cost of a call (Python, launches, mapping memory)"
    if copy_seconds > 0.6 * kernels:
        return f"{text}: bound by memory"
    return f"{text}: bound by instructions (arithmetic, and transposing packets between memory and lanes)"
