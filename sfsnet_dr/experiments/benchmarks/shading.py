"""``sfsnet-dr bench render``: SH rendering against torch and the memory, and its time over the image size."""

from __future__ import annotations

import resource
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from sfsnet_dr.experiments.benchmarks.agreement import require_agreement, value_and_gradients
from sfsnet_dr.experiments.benchmarks.common import (
    Times,
    bandwidth_copy,
    bytes_a_second,
    compiler_missing,
    describe_bound,
    make_copy,
    time_in_turns,
)
from sfsnet_dr.render import shading_drjit, shading_numpy, shading_torch
from sfsnet_dr.report.record import Record, make_record

#: Batch, height, width at which the forms are compared.
SIZE: Final = (64, 128, 128)

#: Sides of the square images over which the time should grow with the number of pixels.
SIDES: Final = (64, 128, 256, 512, 1024, 2048)

#: Bytes a pixel in single precision: normal and albedo are read, the image is written.
BYTES: Final = 36

#: Calls over which new memory is counted.
STEADY: Final = 30

Render = Callable[[Tensor, Tensor, Tensor], Tensor]


def bench_render(command: str, *, rounds: int = 15, compiled: bool = True) -> tuple[list[Record], list[str]]:
    """Measure the SH renderer, order 2.

    Args:
        command: the command line, for the records.
        rounds: turns that each contender has.
        compiled: whether to measure torch.compile too.

    Returns:
        Records, and lines to read.
    """

    def record(what: str, value: float, unit: str, interval: tuple[float, float] | None = None) -> Record:
        return make_record(f"render.{what}", value, unit, command=command, interval=interval, seed=0)

    missing = compiler_missing() if compiled else "left out"
    forms: dict[str, Render] = {"drjit": shading_drjit.f_render, "torch_eager": shading_torch.f_render}
    if missing is None:
        torch.compiler.reset()
        forms["torch_compile"] = torch.compile(shading_torch.f_render, dynamic=False)
    for name, form in forms.items():
        check_renderer(name, form, example_inputs(SIZE))
    inputs, pixels = example_inputs(SIZE), SIZE[0] * SIZE[1] * SIZE[2]
    contenders: dict[str, Callable[[], Any]] = {name: _rendering(f, inputs) for name, f in forms.items()}
    contenders |= {f"{name}_gradient": _step(f, inputs) for name, f in forms.items()}
    contenders |= {"copy": bandwidth_copy(), "same_size_copy": make_copy(BYTES * pixels)}
    times = time_in_turns(contenders, rounds)
    ours = times["drjit"]
    bandwidth = bytes_a_second(times["copy"])
    records = [record("copy_bandwidth", bandwidth / 1e9, "GB/s")]
    records += [record(f"ratio.{n}", *_ratio(ours, times[n])) for n in forms if n != "drjit"]
    records += [
        record(f"ratio.gradient.{n}", *_ratio(times["drjit_gradient"], times[f"{n}_gradient"]))
        for n in forms
        if n != "drjit"
    ]
    share, interval = ours.share(times["copy"], BYTES * pixels)
    records += [
        record("share.copy_bandwidth", share, "1", interval),
        record("share.same_size_copy", *_ratio(ours, times["same_size_copy"])),
    ]
    records += [_milliseconds(record, name, found) for name, found in times.items()]
    lines = [f"torch.compile: not available: {missing}"] if missing else []
    lines += [f"64x128x128: {1e3 * ours.median:.2f} ms, {100 * share:.0f} % of the copy bandwidth"]
    lines += [f"    {describe_bound(contenders['drjit'], ours.median, BYTES * pixels / bandwidth)}"]
    return _over_sizes(record, records, lines, rounds)


def example_inputs(size: tuple[int, int, int], seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Random normals not of unit length, albedo and light of order 2."""
    batch, height, width = size
    rng = torch.Generator().manual_seed(seed)
    normal = torch.randn(batch, 3, height, width, generator=rng)
    albedo = torch.rand(batch, 3, height, width, generator=rng)
    return normal, albedo, torch.randn(batch, 27, generator=rng)


def check_renderer(name: str, form: Render, inputs: tuple[Tensor, Tensor, Tensor]) -> None:
    """Hold the image and its gradients to NumPy's and torch's in double precision.

    Raises:
        RunError: if they differ; see ``require_agreement``.
    """
    doubles = [t.double().requires_grad_() for t in inputs]
    upstream = torch.ones_like(inputs[0])
    expected = value_and_gradients(shading_torch.f_render(*doubles), doubles, upstream.double())
    image = torch.from_numpy(shading_numpy.f_render(*(t.detach().numpy() for t in doubles)))
    leaves = [t.detach().requires_grad_() for t in inputs]
    found = value_and_gradients(form(*leaves), leaves, upstream)
    require_agreement(f"bench render: {name}", found, [image, *expected[1:]])  # type: ignore[list-item]


def page_faults(call: Callable[[], Any]) -> float:
    """Pages of new memory that one call asks the system for, on average, once it has been called often."""
    for _ in range(STEADY):
        call()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(STEADY):
        call()
    return (resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before) / STEADY


def _over_sizes(
    record: Callable[..., Record], records: list[Record], lines: list[str], rounds: int
) -> tuple[list[Record], list[str]]:
    seconds = []
    for side in SIDES:
        call = _rendering(shading_drjit.f_render, example_inputs((1, side, side)))
        found = time_in_turns({"drjit": call}, rounds)["drjit"]
        seconds.append(found.median)
        records.append(_milliseconds(record, f"drjit.1x{side}x{side}", found))
    pixels = np.array(SIDES, dtype=float) ** 2
    # Relative errors count alike: divide both sides by the time.
    rows = np.stack([np.ones_like(pixels), pixels], 1) / np.array(seconds)[:, None]
    (fixed, each), *_ = np.linalg.lstsq(rows, np.ones(len(SIDES)))
    worst = float(np.abs(rows @ (fixed, each) - 1).max())
    faults = page_faults(_rendering(shading_drjit.f_render, example_inputs(SIZE)))
    records += [
        record("linear.fixed", 1e6 * fixed, "us"),
        record("linear.per_pixel", 1e9 * each, "ns"),
        record("linear.worst_deviation", worst, "1"),
        record("steady.page_faults", faults, "1"),
    ]
    lines += [
        f"{SIDES[0]}^2 to {SIDES[-1]}^2: {1e6 * fixed:.0f} us + {1e9 * each:.2f} ns a pixel, "
        f"within {100 * worst:.0f} % of every time measured",
        f"new pages of memory a call in steady state: {faults:.1f}",
    ]
    return records, lines


def _milliseconds(record: Callable[..., Record], name: str, times: Times) -> Record:
    low, high = times.interval()
    return record(f"time.{name}", 1e3 * times.median, "ms", (1e3 * low, 1e3 * high))


def _ratio(ours: Times, other: Times) -> tuple[float, str, tuple[float, float]]:
    ratio, interval = ours.ratio(other)
    return ratio, "1", interval


def _rendering(render: Render, inputs: tuple[Tensor, Tensor, Tensor]) -> Callable[[], Any]:
    def call() -> Tensor:
        with torch.no_grad():
            return render(*inputs)

    return call


def _step(render: Render, inputs: tuple[Tensor, Tensor, Tensor]) -> Callable[[], Any]:
    leaves = [t.detach().requires_grad_() for t in inputs]
    upstream = torch.ones_like(inputs[0])
    return lambda: torch.autograd.grad(render(*leaves), leaves, upstream)
