"""The benches: their arithmetic on known times, and small runs of both."""

from __future__ import annotations

import time
from typing import Any

import pytest
import torch

from sfsnet_dr.core.errors import RunError
from sfsnet_dr.experiments.benchmarks import common as contests
from sfsnet_dr.experiments.benchmarks import loss, shading
from sfsnet_dr.experiments.benchmarks.agreement import NAMES, require_agreement
from sfsnet_dr.experiments.benchmarks.common import Times, time_in_turns
from sfsnet_dr.experiments.benchmarks.loss_variants import VARIANTS, check_variant
from sfsnet_dr.losses.reconstruction import reconstruction_l1
from sfsnet_dr.render import shading_drjit, shading_torch


def test_ratio_is_taken_round_by_round() -> None:
    """The second round ran on a slower machine; both contenders did."""
    ours, other = Times((1.0, 10.0, 1.0)), Times((3.0, 30.0, 6.0))
    assert ours.ratio(other) == (3.0, (3.0, 6.0))
    assert ours.median == 1.0


def test_share_is_of_the_bandwidth_in_the_same_round() -> None:
    """Half of the bytes in as long as the copy takes, in both rounds, on a machine that slowed down."""
    ours, copy = Times((1.0, 3.0)), Times((1.0, 3.0))
    assert ours.share(copy, contests.COPY_BYTES) == (0.5, (0.5, 0.5))


def test_every_contender_has_every_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contests, "TURN_SECONDS", 0.0)
    calls: list[str] = []
    found = time_in_turns({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, rounds=4)
    assert calls[:4] == ["a", "a", "b", "b"]
    assert calls[4:] == (["a"] * contests.IN_A_ROW + ["b"] * contests.IN_A_ROW) * 4
    assert all(len(times.rounds) == 4 for times in found.values())


def test_a_turn_outlasts_the_threads_of_the_contender_before() -> None:
    """The first calls are disturbed; the turn goes on until calls are not, and the fastest counts."""
    start, calls = time.perf_counter(), 0

    def disturbed_at_first() -> None:
        nonlocal calls
        calls += 1
        time.sleep(0.004 if time.perf_counter() < start + 0.02 else 0.001)

    (turn,) = time_in_turns({"a": disturbed_at_first}, rounds=1)["a"].rounds
    assert turn < 0.003
    assert calls > contests.IN_A_ROW


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contests, "COPY_BYTES", 2**20)
    monkeypatch.setattr(contests, "TURN_SECONDS", 0.0)
    monkeypatch.setattr(loss, "SIZES", ((2, 8, 8), (1, 16, 16)))
    monkeypatch.setattr(shading, "SIZE", (2, 16, 16))
    monkeypatch.setattr(shading, "SIDES", (8, 16, 32))


@pytest.mark.usefixtures("small")
def test_bench_loss() -> None:
    records, lines = loss.bench_loss("command", rounds=2, compiled=False, variants=False)
    values = {r.what: r.value for r in records}
    for name in ("loss.ratio.torch_eager", "loss.share.roofline"):
        assert values[name] == min(values[f"{name}.2x8x8"], values[f"{name}.1x16x16"])
    assert values["loss.ratio.torch_eager.2x8x8"] > 0
    assert any("bound by" in line for line in lines)
    assert any("torch.compile: not available" in line for line in lines)


@pytest.mark.usefixtures("small")
def test_bench_render() -> None:
    records, lines = shading.bench_render("command", rounds=2, compiled=False)
    names = {r.what for r in records}
    assert {"render.ratio.torch_eager", "render.share.copy_bandwidth", "render.time.drjit.1x32x32"} <= names
    assert any("bound by" in line for line in lines)


INPUTS = loss.example_inputs((2, 16, 16))


@pytest.mark.slow
@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant_agrees_with_the_reference(name: str) -> None:
    check_variant(name, VARIANTS[name], INPUTS, loss.reference_result(INPUTS))


def test_the_variant_in_use_agrees_with_the_reference() -> None:
    check_variant("used", VARIANTS["used"], INPUTS, loss.reference_result(INPUTS))


@pytest.mark.parametrize("part", [1, 2, 3])
def test_a_wrong_scale_of_a_gradient_stops_the_bench(part: int) -> None:
    def compute(*inputs: torch.Tensor) -> Any:
        value, gradients = VARIANTS["used"].compute(*inputs)
        return value, [g * (2 if k + 1 == part else 1) for k, g in enumerate(gradients)]

    wrong = VARIANTS["used"]._replace(compute=compute)
    with pytest.raises(RunError, match=f"variant 'twice': {NAMES[part]} differs from the reference by 1 "):
        check_variant("twice", wrong, INPUTS, loss.reference_result(INPUTS))


def test_a_wrong_value_stops_the_bench() -> None:
    def compute(*inputs: torch.Tensor) -> Any:
        value, gradients = VARIANTS["used"].compute(*inputs)
        return 1.1 * value, gradients

    with pytest.raises(RunError, match=r"value differs from the reference by 0\.1 "):
        check_variant(
            "more", VARIANTS["used"]._replace(compute=compute), INPUTS, loss.reference_result(INPUTS)
        )


@pytest.mark.usefixtures("small")
def test_bench_loss_checks_before_it_times(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(*inputs: Any, backend: str = "drjit") -> Any:
        value = reconstruction_l1(*inputs, backend="torch")
        return 2 * value if backend == "drjit" else value

    monkeypatch.setattr(loss, "reconstruction_l1", wrong)
    with pytest.raises(RunError, match="bench loss: drjit: gradient of normals differs"):
        loss.bench_loss("command", rounds=1, compiled=False, variants=False)


@pytest.mark.usefixtures("small")
def test_bench_render_checks_before_it_times(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = shading_torch.f_render
    monkeypatch.setattr(shading_drjit, "f_render", lambda n, a, light: wrong(n, a, 0.5 * light))
    with pytest.raises(RunError, match="bench render: drjit: value differs"):
        shading.bench_render("command", rounds=1, compiled=False)


def test_nan_is_no_agreement() -> None:
    nan = torch.full((3,), float("nan"))
    with pytest.raises(RunError, match="by inf"):
        require_agreement("x", [nan, None, None, None], [torch.ones(3)] * 4)
