"""The bench of training: its arithmetic on known times, and a small run."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from helpers.spheres import write_spheres
from torch import nn
from torch.utils.flop_counter import FlopCounterMode
from train.test_trainer import RECIPE

from sfsnet_dr.core.errors import RunError
from sfsnet_dr.experiments.benchmarks import common as contests
from sfsnet_dr.experiments.benchmarks import train
from sfsnet_dr.experiments.benchmarks.common import Times
from sfsnet_dr.experiments.benchmarks.train import PRODUCT_SIZE, StepsApart, layer_products
from sfsnet_dr.train.distributed import ProcessGroup


def test_shares_and_ratios_are_of_whole_steps() -> None:
    """A step of 3 s, a third of it the loss, and 1 s for data; the plain one takes 7 s, or 5 s."""
    times = {
        "step": Times((3.0, 3.0)),
        "plain": Times((7.0, 7.0)),
        "plain_kept": Times((5.0, 5.0)),
        "data": Times((1.0, 1.0)),
        "loss": Times((1.0, 1.0)),
        "matmul": Times((0.1, 0.1)),
    }
    records, lines = train._told(
        RECIPE, times, 2 * 10 * PRODUCT_SIZE**3, "", fast=False, native=False, team=ProcessGroup()
    )
    values = {record.what: record.value for record in records}
    assert values["train.images_per_s"] == RECIPE.batch_size / 4
    assert values["train.ratio.plain_step"] == 2
    assert values["train.ratio.plain_step_kept"] == 1.5
    assert values["train.share.peak"] == 0.25  # ten such products are a second's work of the four
    assert values["train.share.data"] == values["train.share.loss"] == 0.25
    assert values["train.share.network"] == 0.5
    assert values["train.bfloat16"] == values["train.bfloat16.native"] == values["train.gpu"] == 0
    assert "no bfloat16 instructions" in lines[0]


def test_a_small_bench_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contests, "TURN_SECONDS", 0.0)
    data = write_spheres(tmp_path / "faces", 2)
    records, _ = train.bench_train(RECIPE, data, "sfsnet-dr bench train", rounds=2)
    values = {record.what: record.value for record in records}
    assert values["train.images_per_s"] > 0
    assert values["train.ratio.plain_step"] > 0
    assert values["train.ratio.plain_step_kept"] > 0
    assert values["train.gpu"] == torch.cuda.is_available()


def test_products_are_counted() -> None:
    """A convolution takes as much again for its weights' gradient, and for its input's but for the first."""
    model = RECIPE.make_model()
    found = layer_products(RECIPE, torch.rand(2, 3, 16, 16), ProcessGroup())
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        model(torch.rand(2, 3, 16, 16))
    first = next(module for module in model.modules() if isinstance(module, nn.Conv2d))
    assert found == 3 * counter.get_total_flops() - 2 * 2 * 3 * 16**2 * first.out_channels * 7**2


def test_a_process_of_steps_that_fails_is_told(tmp_path: Path) -> None:
    with (
        StepsApart(RECIPE, tmp_path / "missing") as steps,
        pytest.raises(RunError, match="plain steps ended"),
    ):
        steps()
