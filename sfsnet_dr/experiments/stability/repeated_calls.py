"""Many calls: memory, kernels, threads, last bits."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from typing import Final

from sfsnet_dr.experiments.stability.process_case import Finding, ProcessCase

CALLS: Final = 10_000
#: Megabytes that the peak may grow in these calls. A leak of one 4 x 4 image a call would be 2.
GROWTH: Final = 1.0
#: Kernels for one new image size.
KERNELS: Final = 4

_SIZES: Final = ((4, 4), (5, 7), (16, 8), (31, 33), (1, 97))
_THREADS: Final = 8
_RUNS: Final = 10

#: Two 32-bit roundings of the largest number, twice over.
_FAST_MATH: Final = 4.8e-7


def _calls(name: str) -> Finding:
    from sfsnet_dr.experiments.stability.backends import find_backend
    from sfsnet_dr.experiments.stability.workload import make_inputs, result_digest

    form, arguments = find_backend(name), make_inputs(0, 1, 4, 4)
    expected = [result_digest(form, arguments) for _ in range(200)][-1]
    count = _kernel_counter()
    start, compiled = _peak_megabytes(), 0
    for call in range(CALLS):
        if result_digest(form, arguments) != expected:
            return Finding(call, f"call {call} gives other bits")
        compiled += count()
    growth = _peak_megabytes() - start
    if compiled:
        return Finding(growth, f"{compiled} kernels compiled again")
    return Finding(growth, "" if growth <= GROWTH else f"memory grew by {growth:.2f} MB, {GROWTH:g} allowed")


def _image_sizes(name: str) -> Finding:
    from sfsnet_dr.experiments.stability.backends import find_backend
    from sfsnet_dr.experiments.stability.workload import make_inputs, result_digest

    form, count = find_backend(name), _kernel_counter()
    result_digest(form, make_inputs(0, 2, 3, 3))  # what does not depend on the size of an image
    count()
    most = 0
    for height, width in _SIZES:
        result_digest(form, make_inputs(0, 2, height, width))
        most = max(most, count())
        result_digest(form, make_inputs(0, 5, height, width))
        result_digest(form, make_inputs(0, 4, width, height))
        again = count()
        if again:
            return Finding(again, f"{again} kernels compiled for another batch size")
    return Finding(most, "" if most <= KERNELS else f"{most} kernels for one image size, {KERNELS} allowed")


def _threads(name: str) -> Finding:
    from sfsnet_dr.experiments.stability.backends import find_backend
    from sfsnet_dr.experiments.stability.workload import make_inputs, result_digest

    form = find_backend(name)
    arguments = [make_inputs(seed, 1 + seed % 3, 40, 30) for seed in range(_THREADS)]
    expected = [result_digest(form, a) for a in arguments]

    def work(index: int) -> int:
        return sum(result_digest(form, arguments[index]) != expected[index] for _ in range(_RUNS))

    return _in_threads(work, _RUNS)


def _backward_threads(name: str) -> Finding:
    """Forward passes here, each graph differentiated by a thread of its own, all at once."""
    from sfsnet_dr.experiments.stability.backends import find_backend
    from sfsnet_dr.experiments.stability.workload import (
        float_bits,
        make_inputs,
        result_digest,
        run_backward,
        run_forward,
    )

    form = find_backend(name)
    arguments = [make_inputs(seed, 1 + seed % 3, 40, 30) for seed in range(_THREADS)]
    expected = [result_digest(form, a) for a in arguments]
    graphs = [[run_forward(form, a) for _ in range(_RUNS)] for a in arguments]

    def work(index: int) -> int:
        there = arguments[index]
        found = [float_bits(total, *run_backward(form, total, there)) for total in graphs[index]]
        return sum(f != expected[index] for f in found)

    return _in_threads(work, _RUNS)


def _repeated(name: str) -> Finding:
    from sfsnet_dr.experiments.stability.backends import find_backend
    from sfsnet_dr.experiments.stability.workload import make_inputs, result_digest

    form, arguments = find_backend(name), make_inputs(0, 5, 100, 100)
    found = {result_digest(form, arguments) for _ in range(30)}
    return Finding(30, "" if len(found) == 1 else f"{len(found)} different results in 30 runs")


def _fast_math(name: str) -> Finding:
    from dataclasses import replace

    from sfsnet_dr.experiments.stability.backends import find_backend
    from sfsnet_dr.experiments.stability.workload import flatten_results, float_bits, make_inputs

    form, arguments = find_backend(name), make_inputs(0, 5, 100, 100)
    fast, strict, again = (
        flatten_results(replace(form, fast_math=on), arguments) for on in (True, False, True)
    )
    if float_bits(*fast) != float_bits(*again):
        return Finding(3, "FastMath gives other bits when it is switched on again")
    worst = max(float((a - b).abs().max() / b.abs().max()) for a, b in zip(fast, strict, strict=True))
    return Finding(
        3, "" if worst <= _FAST_MATH else f"FastMath changes results by {worst:.2g} of the largest"
    )


def _in_threads(work: Callable[[int], int], runs: int) -> Finding:
    wrong, errors = [0] * _THREADS, []

    def guarded(index: int) -> None:
        try:
            wrong[index] = work(index)
        except Exception as error:  # a thread's error would be lost
            errors.append(f"{type(error).__name__}: {error}")

    threads = [threading.Thread(target=guarded, args=(index,)) for index in range(_THREADS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        return Finding(len(errors), errors[0])
    return Finding(_THREADS * runs, f"{sum(wrong)} results of other bits" if any(wrong) else "")


def _kernel_counter() -> Callable[[], int]:
    """Counts the kernels compiled since it was called last."""
    from sfsnet_dr.scene.jit import dr

    dr.set_flag(dr.JitFlag.KernelHistory, True)
    dr.kernel_history_clear()

    def count() -> int:
        history = dr.kernel_history()
        return sum(entry["type"] == dr.KernelType.JIT and not entry["cache_hit"] for entry in history)

    return count


def _peak_megabytes() -> float:
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


#: All of them, in the order of the page. The figure is what the expectation names.
CASES: Final = (
    ProcessCase(
        f"{CALLS:,} calls with gradients, 4 x 4",
        f"peak memory grows by at most {GROWTH:g} MB, no kernel is "
        "compiled again, every call gives the same bits",
        "steady state: all caches are warm after 200 calls",
        _calls,
        "MB",
        differentiable_only=True,
        alone=True,
        limit=600,
    ),
    ProcessCase(
        "new image sizes, then new batch sizes",
        f"at most {KERNELS} kernels for an image size, none for a batch",
        "the number of pixels of an image is a constant in a kernel, that of images is not",
        _image_sizes,
        "kernels",
        jit_only=True,
    ),
    ProcessCase(
        f"{_THREADS} threads call at once",
        "same bits as one after the other",
        "forward passes wait for each other",
        _threads,
    ),
    ProcessCase(
        f"{_THREADS} threads differentiate at once",
        "same bits as one after the other",
        "torch runs a backward pass in the thread that asks for it",
        _backward_threads,
        differentiable_only=True,
    ),
    ProcessCase(
        "30 runs, 5 images of 100 x 100",
        "equal bit for bit",
        "sums have one order, whatever thread comes first",
        _repeated,
    ),
    ProcessCase(
        "FastMath on, off, on",
        f"on and on: equal bit for bit; off: within {_FAST_MATH:.1g} of the largest",
        "it may shorten a reciprocal root: 2.4e-7 was measured, the bound is twice that",
        _fast_math,
        jit_only=True,
    ),
)
