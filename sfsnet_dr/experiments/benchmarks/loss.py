"""``sfsnet-dr bench loss``: the reconstruction loss, forward and backward, against its twins and memory."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import torch
from torch import Tensor

from sfsnet_dr.experiments.benchmarks.agreement import Result, require_agreement, value_and_gradients
from sfsnet_dr.experiments.benchmarks.common import (
    Times,
    bandwidth_copy,
    bytes_a_second,
    compiler_missing,
    describe_bound,
    make_copy,
    time_in_turns,
)
from sfsnet_dr.experiments.benchmarks.loss_variants import VARIANTS, check_variant, make_call
from sfsnet_dr.losses.reconstruction import reconstruction_l1
from sfsnet_dr.report.record import Record, make_record

#: Batch, height, width.
SIZES: Final = ((8, 128, 128), (16, 128, 128), (64, 128, 128), (16, 256, 256))

#: Size at which the variants are compared.
VARIANT_SIZE: Final = (16, 128, 128)

#: Bytes a pixel that the loss with its gradients has to move, in single precision: normal, albedo and image
#: are read, and two gradients written. (The mask's 4 are not counted.)
BYTES: Final = 60

Inputs = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]


class SizeResult(NamedTuple):
    """What was measured at one size."""

    size: tuple[int, int, int]
    times: dict[str, Times]
    bound: str

    @property
    def suffix(self) -> str:
        return "x".join(map(str, self.size))

    @property
    def traffic(self) -> int:
        return BYTES * self.size[0] * self.size[1] * self.size[2]


def bench_loss(
    command: str, *, rounds: int = 15, compiled: bool = True, variants: bool = True
) -> tuple[list[Record], list[str]]:
    """Measure the loss at every size, and every variant of its kernel at one.

    Args:
        command: the command line, for the records.
        rounds: turns that each contender has.
        compiled: whether to measure torch.compile too; it compiles for a minute or so.
        variants: whether to measure the variants.

    Returns:
        Records, and lines to read.
    """
    missing = compiler_missing() if compiled else "left out"
    sized = [_measure(size, rounds, missing is None) for size in SIZES]
    writer = _Writer(command)
    records = writer.all(sized)
    lines = writer.lines(sized, missing)
    if variants:
        inputs = example_inputs(VARIANT_SIZE)
        expected = reference_result(inputs)
        for name, variant in VARIANTS.items():
            check_variant(name, variant, inputs, expected)
        found = time_in_turns(
            {name: make_call(variant, inputs) for name, variant in VARIANTS.items()}, rounds
        )
        records += [writer.time(f"loss.variant.{name}", times) for name, times in found.items()]
        lines += ["", "variants at " + "x".join(map(str, VARIANT_SIZE)) + ":"]
        lines += [f"  {1e3 * t.median:8.2f} ms  {name}: {VARIANTS[name].text}" for name, t in found.items()]
    return records, lines


def example_inputs(size: tuple[int, int, int], seed: int = 0) -> Inputs:
    """Random inputs: normals not of unit length, a mask of 0 and 1 that counts 70 % of the pixels."""
    batch, height, width = size
    rng = torch.Generator().manual_seed(seed)
    normal = torch.randn(batch, 3, height, width, generator=rng)
    albedo, image = (torch.rand(batch, 3, height, width, generator=rng) for _ in range(2))
    light = torch.randn(batch, 27, generator=rng)
    mask = (torch.rand(batch, 1, height, width, generator=rng) > 0.3).float()
    return normal, albedo, light, image, mask


def reference_result(inputs: Inputs) -> Result:
    """Value and gradients by torch in double precision: what every contender is held to."""
    doubles = tuple(t.double() for t in inputs)
    leaves = [t.requires_grad_() for t in doubles[:3]]
    return value_and_gradients(_eager(*leaves, *doubles[3:]), leaves)


def make_step(loss: Callable[..., Tensor], inputs: Inputs) -> Callable[[], Any]:
    """Forward and backward of a loss."""
    normal, albedo, light, image, mask = inputs
    leaves = [t.detach().requires_grad_() for t in (normal, albedo, light)]
    return lambda: torch.autograd.grad(loss(*leaves, image, mask), leaves)


def _measure(size: tuple[int, int, int], rounds: int, compiled: bool) -> SizeResult:
    inputs = example_inputs(size)
    ours = make_step(lambda *x: reconstruction_l1(*x, backend="drjit"), inputs)
    eager = make_step(_eager, inputs)
    contenders = {"drjit": ours, "torch_eager": eager}
    if compiled:
        torch.compiler.reset()
        contenders["torch_compile"] = make_step(torch.compile(_eager, dynamic=False), inputs)
    expected = reference_result(inputs)
    for name, call in contenders.items():
        gradients = call()
        require_agreement(f"bench loss: {name}", [None, *gradients], list(expected))  # type: ignore[arg-type]
    traffic = BYTES * size[0] * size[1] * size[2]
    contenders |= {"same_size_copy": make_copy(traffic), "copy": bandwidth_copy()}
    times = time_in_turns(contenders, rounds)
    copy_seconds = traffic / bytes_a_second(times["copy"])
    return SizeResult(size, times, describe_bound(ours, times["drjit"].median, copy_seconds))


def _eager(*inputs: Tensor) -> Tensor:
    return reconstruction_l1(*inputs, backend="torch")


def _bandwidth(sized: list[SizeResult]) -> float:
    """GB/s."""
    return statistics.median(bytes_a_second(s.times["copy"]) for s in sized) / 1e9


class _Writer:
    def __init__(self, command: str) -> None:
        self._command = command

    def all(self, sized: list[SizeResult]) -> list[Record]:
        records = [self._record("loss.copy_bandwidth", _bandwidth(sized), "GB/s")]
        for name in ("torch_eager", "torch_compile"):
            if all(name in s.times for s in sized):
                ratios = [s.times["drjit"].ratio(s.times[name]) for s in sized]
                records += self._with_worst(f"loss.ratio.{name}", sized, ratios)
        shares = [self._share(s) for s in sized]
        records += self._with_worst("loss.share.roofline", sized, shares)
        same = [s.times["drjit"].ratio(s.times["same_size_copy"]) for s in sized]
        records += self._with_worst("loss.share.same_size_copy", sized, same)
        for s in sized:
            records += [self.time(f"loss.time.{name}.{s.suffix}", times) for name, times in s.times.items()]
        return records

    def lines(self, sized: list[SizeResult], missing: str | None) -> list[str]:
        lines = [f"copy bandwidth {_bandwidth(sized):.1f} GB/s (read and written, beyond the caches)"]
        lines += [f"torch.compile: not available: {missing}"] if missing else []
        for s in sized:
            share, _ = self._share(s)
            line = f"{s.suffix}: {1e3 * s.times['drjit'].median:.2f} ms, {100 * share:.0f} % of the roofline"
            for name in ("torch_eager", "torch_compile"):
                if name in s.times:
                    ratio, _ = s.times["drjit"].ratio(s.times[name])
                    line += f", {ratio:.1f} x {name.replace('_', ' ')}"
            lines += [line, f"    {s.bound}"]
        return lines

    def time(self, what: str, times: Times) -> Record:
        low, high = times.interval()
        return self._record(what, 1e3 * times.median, "ms", (1e3 * low, 1e3 * high))

    def _share(self, s: SizeResult) -> tuple[float, tuple[float, float]]:
        return s.times["drjit"].share(s.times["copy"], s.traffic)

    def _with_worst(
        self, what: str, sized: list[SizeResult], values: list[tuple[float, tuple[float, float]]]
    ) -> list[Record]:
        worst, interval = min(values)
        each = [
            self._record(f"{what}.{s.suffix}", v, "1", i) for s, (v, i) in zip(sized, values, strict=True)
        ]
        return [self._record(what, worst, "1", interval), *each]

    def _record(
        self, what: str, value: float, unit: str, interval: tuple[float, float] | None = None
    ) -> Record:
        return make_record(what, value, unit, command=self._command, interval=interval, seed=0)
