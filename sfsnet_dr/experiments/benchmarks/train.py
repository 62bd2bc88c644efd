"""``sfsnet-dr bench train``: a recipe's training step against the naive one."""

from __future__ import annotations

import multiprocessing
import statistics
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import torch
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from sfsnet_dr.core.errors import RunError
from sfsnet_dr.core.host import keep_freed_memory
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.dataset import RelitFaces, load_faces
from sfsnet_dr.experiments.benchmarks.common import Times, time_in_turns
from sfsnet_dr.models.base import NetworkOutput
from sfsnet_dr.report.record import Record, make_record
from sfsnet_dr.scene.lights.cache import draw_lights
from sfsnet_dr.train.config import ComputeRecipe, Recipe, multiplies_bfloat16
from sfsnet_dr.train.distributed import ProcessGroup, join_process_group
from sfsnet_dr.train.step import batch_loss, predict_encoded, training_step

#: Lights that images are relit by; their number matters to no time.
_LIGHTS: Final = 64
#: Rows and columns of the matrices whose product shows the peak; larger ones are no faster.
PRODUCT_SIZE: Final = 2048
#: Seconds that a process has to end.
_PATIENCE: Final = 10.0


def relit_faces(recipe: Recipe, data: Path, team: ProcessGroup) -> RelitFaces:
    """The batches of a recipe, under a few of its lights."""
    faces = load_faces(data, recipe.data.view).to(team.device)
    bank = draw_lights(recipe.data.light, min(_LIGHTS, recipe.data.num_lights), recipe.seed)
    return RelitFaces(faces, recipe.batch_size, recipe.data, recipe.seed, bank)


def naive_step(recipe: Recipe) -> Recipe:
    """The recipe in float32, with torch's memory order and loss."""
    compute = ComputeRecipe(
        "float32", channels_last=False, loss_backend="torch", device=recipe.compute.device
    )
    return replace(recipe, compute=compute)


def make_step(recipe: Recipe, batch: FaceBatch, team: ProcessGroup) -> Callable[[], Any]:
    """What makes one step of a fresh network after another."""
    model = recipe.make_model()
    team.prepare(model)
    layout = torch.channels_last if recipe.compute.channels_last else torch.contiguous_format
    model.to(memory_format=layout)  # type: ignore[call-overload]
    adam = torch.optim.Adam(model.parameters())
    return wait_for_device(lambda: training_step(model, adam, batch, recipe, 1e-4, team), team)


def wait_for_device(call: Callable[[], Any], team: ProcessGroup) -> Callable[[], Any]:
    """The call, waited for: a GPU is given work faster than it does it."""
    if team.device.type != "cuda":
        return call

    def waited() -> None:
        call()
        torch.cuda.synchronize()

    return waited


def layer_products(recipe: Recipe, image: Tensor, team: ProcessGroup) -> int:
    """Multiplications and additions of the convolutions and products of one step on a batch of images."""
    model = recipe.make_model()
    team.prepare(model)
    with FlopCounterMode(display=False) as counter:
        torch.stack([part.sum() for part in model(image)]).sum().backward()  # type: ignore[no-untyped-call]
    return int(counter.get_total_flops())


def large_product(recipe: Recipe, team: ProcessGroup) -> Callable[[], Any]:
    """The product of two large matrices in the precision of a recipe's step."""
    kind = torch.bfloat16 if recipe.compute.bfloat16(team.device) else torch.float32
    left, right = torch.rand(2, PRODUCT_SIZE, PRODUCT_SIZE, device=team.device).to(kind)
    return wait_for_device(lambda: left @ right, team)


class StepsApart:
    """Steps of a recipe in a process of its own, whose memory is torch's and the C library's own affair.

    Calling it makes one step. A context manager; the process ends with it.

    Raises:
        RunError: when called, if the process has ended.
    """

    def __init__(self, recipe: Recipe, data: Path) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, recipe, data), daemon=True)
        self._process.start()
        theirs.close()

    def __call__(self) -> None:
        """Make one step."""
        try:
            self._pipe.send(None)
            self._pipe.recv()
        except (EOFError, OSError) as error:
            raise RunError("bench train: the process of the plain steps ended; see above") from error

    def __enter__(self) -> StepsApart:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pipe.close()  # which ends its loop
        self._process.join(_PATIENCE)
        self._process.kill()


def _serve(pipe: Connection, recipe: Recipe, data: Path) -> None:
    with join_process_group(recipe.compute.device) as team:
        step = make_step(recipe, relit_faces(recipe, data, team).batch(0), team)
        while True:
            try:
                pipe.recv()
            except EOFError:
                return
            step()
            pipe.send(None)


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
    recipe = replace(recipe, real=replace(recipe.real, batch_fraction=0.0))
    with join_process_group(recipe.compute.device) as team, StepsApart(naive_step(recipe), data) as plain:
        keep_freed_memory()
        batches = relit_faces(recipe, data, team)
        times = time_in_turns({"plain": plain, **_contenders(recipe, batches, team)}, rounds)
        work = layer_products(recipe, batches.batch(0).image, team)
        fast = recipe.compute.bfloat16(team.device)
        native = multiplies_bfloat16(team.device)
    return _told(recipe, times, work, command, fast, native, team)


def _contenders(recipe: Recipe, batches: RelitFaces, team: ProcessGroup) -> dict[str, Callable[[], Any]]:
    steps = iter(range(10**9))
    batch = batches.batch(0)
    model = recipe.make_model()
    team.prepare(model)
    answer = NetworkOutput(*(part.detach() for part in predict_encoded(model, batch.image, recipe)))

    def loss() -> None:
        leaves = NetworkOutput(*(part.requires_grad_() for part in answer))
        total, _ = batch_loss(leaves, batch, recipe)
        torch.autograd.grad(total, leaves)

    return {
        "step": make_step(recipe, batch, team),
        "plain_kept": make_step(naive_step(recipe), batch, team),
        "data": wait_for_device(lambda: batches.batch(next(steps)), team),
        "loss": wait_for_device(loss, team),
        "matmul": large_product(recipe, team),
    }


def _told(
    recipe: Recipe,
    times: dict[str, Times],
    work: int,
    command: str,
    fast: bool,
    native: bool,
    team: ProcessGroup,
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
        return make_record(f"train.{what}", value, unit, command=command, interval=interval, seed=recipe.seed)

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
