"""``sfsnet-dr bench train``: a recipe's step against the plain float32 one, and where its time goes."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from sfsnet_dr.base.allocator import keep_freed_memory
from sfsnet_dr.data.dataset import RelitFaces
from sfsnet_dr.fit.recipe import Recipe, multiplies_bfloat16
from sfsnet_dr.fit.step import batch_loss, predicted
from sfsnet_dr.fit.team import Team, join
from sfsnet_dr.model.outputs import Decomposition
from sfsnet_dr.report.record import Record, measured
from sfsnet_dr.study.bench.contest import Times, contest
from sfsnet_dr.study.bench.training_steps import (
    PRODUCT_SIZE,
    StepsApart,
    finished,
    large_product,
    plainly,
    products,
    relit_faces,
    stepper,
)


def bench_train(
    recipe: Recipe, data: Path, command: str, *, rounds: int = 5
) -> tuple[list[Record], list[str]]:
    """Measure the steps of a recipe on rendered faces.

    The plain step is the same network, batch and loss in float32 with the default memory order, on the same
    device in the same run: ``plain`` in a process of its own, as anybody would write it, ``plain_kept`` in
    this one, which keeps freed memory as the trainer does. Photographs of the recipe are left out: they cost
    less than rendered faces. ``share.peak`` is what a step's convolutions and products would take at the
    speed of one large matrix product in the step's precision, relative to what it took: the roofline.

    Args:
        recipe: network, batch size, precision and so on.
        data: folder of bundles; a batch of them is enough.
        command: the command line, for the records.
        rounds: turns that each contender has.

    Returns:
        Records, and lines to read.
    """
    recipe = replace(recipe, real=replace(recipe.real, share=0.0))
    with join(recipe.compute.device) as team, StepsApart(plainly(recipe), data) as plain:
        keep_freed_memory()
        batches = relit_faces(recipe, data, team)
        times = contest({"plain": plain, **_contenders(recipe, batches, team)}, rounds)
        work = products(recipe, batches.batch(0).image, team)
        fast = recipe.compute.bfloat16(team.device)
        native = multiplies_bfloat16(team.device)
    return _told(recipe, times, work, command, fast, native, team)


def _contenders(recipe: Recipe, batches: RelitFaces, team: Team) -> dict[str, Callable[[], Any]]:
    steps = iter(range(10**9))
    batch = batches.batch(0)
    model = recipe.make_model()
    team.prepare(model)
    answer = Decomposition(*(part.detach() for part in predicted(model, batch.image, recipe)))

    def loss() -> None:
        leaves = Decomposition(*(part.requires_grad_() for part in answer))
        total, _ = batch_loss(leaves, batch, recipe)
        torch.autograd.grad(total, leaves)

    return {
        "step": stepper(recipe, batch, team),
        "plain_kept": stepper(plainly(recipe), batch, team),
        "data": finished(lambda: batches.batch(next(steps)), team),
        "loss": finished(loss, team),
        "matmul": large_product(recipe, team),
    }


def _told(
    recipe: Recipe, times: dict[str, Times], work: int, command: str, fast: bool, native: bool, team: Team
) -> tuple[list[Record], list[str]]:
    step, data, loss = (times[name].rounds for name in ("step", "data", "loss"))
    whole = Times(tuple(a + b for a, b in zip(step, data, strict=True)))
    plain, kept = (
        Times(tuple(a + b for a, b in zip(times[name].rounds, data, strict=True)))
        for name in ("plain", "plain_kept")
    )
    low, high = whole.interval()
    images = recipe.batch_size

    def record(
        what: str, value: float, unit: str = "1", interval: tuple[float, float] | None = None
    ) -> Record:
        return measured(f"train.{what}", value, unit, command=command, interval=interval, seed=recipe.seed)

    def share(name: str, part: tuple[float, ...]) -> Record:
        found = Times(tuple(p / w for p, w in zip(part, whole.rounds, strict=True)))
        return record(f"share.{name}", found.median, "1", found.interval())

    peak = 2 * PRODUCT_SIZE**3 / times["matmul"].median
    network = tuple(a - b for a, b in zip(step, loss, strict=True))
    (ratio, interval), (same, same_interval) = whole.ratio(plain), whole.ratio(kept)
    records = [
        record("images_per_s", images / whole.median, "1/s", (images / high, images / low)),
        record("ratio.plain_step", ratio, "1", interval),
        record("ratio.plain_step_kept", same, "1", same_interval),
        share("data", data),
        share("loss", loss),
        share("network", network),
        record("flops", 1e-9 * work, "GFLOP"),
        record("peak", 1e-9 * peak, "GFLOP/s"),
        share("peak", tuple(work / peak for _ in step)),
        record("batch_size", images, "images"),
        record("gpu", float(team.device.type == "cuda")),
        record("bfloat16", float(fast)),
        record("bfloat16.native", float(native)),
    ]
    records += [
        record(f"time.{name}", 1e3 * t.median, "ms", (1e3 * t.interval()[0], 1e3 * t.interval()[1]))
        for name, t in times.items()
    ]
    millis = {
        name: f"{1e3 * statistics.median(part):.0f} ms" for name, part in (("data", data), ("loss", loss))
    }
    how = "bfloat16" if fast else "float32"
    why = "" if native else "; this processor has no bfloat16 instructions, so that it cannot gain by them"
    lines = [
        f"{recipe.model.architecture}, {images} images a step on {team.device.type}, in {how}{why}",
        f"{images / whole.median:.2f} images/s, {ratio:.2f} x the plain float32 step, "
        f"{same:.2f} x that with freed memory kept",
        f"data {millis['data']}, loss {millis['loss']} of {1e3 * whole.median:.0f} ms a step",
        f"{100 * work / peak / whole.median:.0f} % of the peak of matrix products, {1e-9 * peak:.0f} GFLOP/s",
    ]
    return records, lines
