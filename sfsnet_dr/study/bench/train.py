"""``sfsnet-dr bench train``: a recipe's step against the plain float32 one, and where its time goes."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import torch

from sfsnet_dr.data.dataset import RelitFaces, load_faces
from sfsnet_dr.data.light_bank import draw_bank
from sfsnet_dr.fit.recipe import ComputeRecipe, Recipe, multiplies_bfloat16
from sfsnet_dr.fit.step import batch_loss, predicted, training_step
from sfsnet_dr.fit.team import Team, join
from sfsnet_dr.model.outputs import Decomposition
from sfsnet_dr.report.record import Record, measured
from sfsnet_dr.study.bench.contest import Times, contest

#: Lights that images are relit by; their number matters to no time.
_LIGHTS: Final = 64


def bench_train(
    recipe: Recipe, data: Path, command: str, *, rounds: int = 5
) -> tuple[list[Record], list[str]]:
    """Measure the steps of a recipe on rendered faces.

    The plain step is the same network, batch and loss in float32 with the default memory order, on the same
    device in the same run. Photographs of the recipe are left out: they cost less than rendered faces.

    Args:
        recipe: network, batch size, precision and so on.
        data: folder of bundles; a batch of them is enough.
        command: the command line, for the records.
        rounds: turns that each contender has.

    Returns:
        Records, and lines to read.
    """
    recipe = replace(recipe, real=replace(recipe.real, share=0.0))
    with join(recipe.compute.device) as team:
        times = contest(_contenders(recipe, data, team), rounds)
        fast = recipe.compute.bfloat16(team.device)
        native = multiplies_bfloat16(team.device)
    return _told(recipe, times, command, fast, native, team)


def _contenders(recipe: Recipe, data: Path, team: Team) -> dict[str, Callable[[], Any]]:
    faces = load_faces(data, recipe.data.view).to(team.device)
    bank = draw_bank(recipe.data.light, min(_LIGHTS, recipe.data.lights), recipe.seed)
    batches = RelitFaces(faces, recipe.batch_size, recipe.data, recipe.seed, bank)
    compute = ComputeRecipe(
        "float32", channels_last=False, loss_backend="torch", device=recipe.compute.device
    )
    steps = iter(range(10**9))
    batch = batches.batch(0)
    model = recipe.make_model()
    team.prepare(model)
    answer = Decomposition(*(part.detach() for part in predicted(model, batch.image, recipe)))

    def loss() -> None:
        leaves = Decomposition(*(part.requires_grad_() for part in answer))
        total, _ = batch_loss(leaves, batch, recipe)
        torch.autograd.grad(total, leaves)

    contenders: dict[str, Callable[[], Any]] = {
        "step": _stepper(recipe, batch, team),
        "plain": _stepper(replace(recipe, compute=compute), batch, team),
        "data": lambda: batches.batch(next(steps)),
        "loss": loss,
    }
    return {name: _finished(call, team) for name, call in contenders.items()}


def _stepper(recipe: Recipe, batch: Any, team: Team) -> Callable[[], Any]:
    model = recipe.make_model()
    team.prepare(model)
    layout = torch.channels_last if recipe.compute.channels_last else torch.contiguous_format
    model.to(memory_format=layout)  # type: ignore[call-overload]
    adam = torch.optim.Adam(model.parameters())
    return lambda: training_step(model, adam, batch, recipe, 1e-4, team)


def _finished(call: Callable[[], Any], team: Team) -> Callable[[], Any]:
    """The call, waited for: a GPU is given work faster than it does it."""
    if team.device.type != "cuda":
        return call

    def waited() -> None:
        call()
        torch.cuda.synchronize()

    return waited


def _told(
    recipe: Recipe, times: dict[str, Times], command: str, fast: bool, native: bool, team: Team
) -> tuple[list[Record], list[str]]:
    step, data, loss = (times[name].rounds for name in ("step", "data", "loss"))
    whole = Times(tuple(a + b for a, b in zip(step, data, strict=True)))
    plain = Times(tuple(a + b for a, b in zip(times["plain"].rounds, data, strict=True)))
    low, high = whole.interval()
    images = recipe.batch_size

    def record(
        what: str, value: float, unit: str = "1", interval: tuple[float, float] | None = None
    ) -> Record:
        return measured(f"train.{what}", value, unit, command=command, interval=interval, seed=recipe.seed)

    def share(name: str, part: tuple[float, ...]) -> Record:
        found = Times(tuple(p / w for p, w in zip(part, whole.rounds, strict=True)))
        return record(f"share.{name}", found.median, "1", found.interval())

    network = tuple(a - b for a, b in zip(step, loss, strict=True))
    ratio, interval = whole.ratio(plain)
    records = [
        record("images_per_s", images / whole.median, "1/s", (images / high, images / low)),
        record("ratio.plain_step", ratio, "1", interval),
        share("data", data),
        share("loss", loss),
        share("network", network),
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
        f"{images / whole.median:.2f} images/s, {ratio:.2f} x the plain float32 step",
        f"data {millis['data']}, loss {millis['loss']} of {1e3 * whole.median:.0f} ms a step",
    ]
    return records, lines
