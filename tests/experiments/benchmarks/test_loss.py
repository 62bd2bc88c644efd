"""The benches: their arithmetic on known times, and small runs of both."""

from __future__ import annotations

import time

import pytest

from sfsnet_dr.experiments.benchmarks import common as contests
from sfsnet_dr.experiments.benchmarks import loss, shading
from sfsnet_dr.experiments.benchmarks.common import Times, contest
from sfsnet_dr.experiments.benchmarks.loss_variants import VARIANTS, run


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
    found = contest({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, rounds=4)
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

    (turn,) = contest({"a": disturbed_at_first}, rounds=1)["a"].rounds
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


@pytest.mark.slow
@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant_runs(name: str) -> None:
    run(VARIANTS[name], loss.example((2, 16, 16)))()
