"""Collapse is seen early, told once, and not where there is none."""

from __future__ import annotations

import pytest
import torch

from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.models.base import NetworkOutput
from sfsnet_dr.train.step import SMALLEST, STEPS, CollapseMonitor, spread_ratios


def faces() -> FaceBatch:
    """Two faces of random normals and albedo, of which the left half counts."""
    generator = torch.Generator().manual_seed(0)
    normal = torch.nn.functional.normalize(torch.randn(2, 3, 8, 8, generator=generator), dim=1)
    albedo = torch.rand(2, 3, 8, 8, generator=generator)
    mask = torch.zeros(2, 1, 8, 8)
    mask[..., :4] = 1
    return FaceBatch(albedo, normal, albedo, torch.zeros(2, 27), mask)


def test_ratios_are_those_of_the_variation_on_the_face() -> None:
    batch = faces()
    perfect = spread_ratios(NetworkOutput(batch.normal, batch.albedo, batch.light), batch)
    assert perfect == {"normal": pytest.approx(1), "albedo": pytest.approx(1)}
    # A tenth of the variation about any constant on the face; beside it anything may stand.
    pale = 0.3 + 0.1 * batch.albedo
    pale[..., 4:] = torch.rand(2, 3, 8, 4)
    flat = torch.zeros_like(batch.normal)
    flat[:, 2] = 1
    assert spread_ratios(NetworkOutput(flat, pale, batch.light), batch) == {
        "normal": pytest.approx(0, abs=1e-6),
        "albedo": pytest.approx(0.1, rel=1e-4),
    }


def test_a_collapse_is_told_once() -> None:
    watch = CollapseMonitor()
    told = [watch.see({"normal": 0.8, "albedo": 0.02}) for _ in range(2 * STEPS)]
    assert [step for step, text in enumerate(told) if text] == [STEPS - 1]
    assert told[STEPS - 1].startswith("albedo has collapsed")
    assert "normal" not in told[STEPS - 1]


def test_a_late_collapse_is_told_within_a_few_spans() -> None:
    watch = CollapseMonitor()
    for _ in range(10 * STEPS):
        assert not watch.see({"normal": 0.9, "albedo": 0.7})
    # (1 - 1 / STEPS)^n falls below SMALLEST / 0.9 after 1.8 spans.
    late = [step for step in range(4 * STEPS) if watch.see({"normal": 0.0, "albedo": 0.7})]
    assert late
    assert 1.5 * STEPS < late[0] < 2.5 * STEPS


def test_single_bad_steps_are_no_collapse() -> None:
    watch = CollapseMonitor()
    ratios = [SMALLEST / 2 if step % 10 == 0 else 0.6 for step in range(4 * STEPS)]
    assert not any(watch.see({"normal": ratio, "albedo": ratio}) for ratio in ratios)
