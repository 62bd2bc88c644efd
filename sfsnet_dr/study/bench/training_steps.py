"""The steps that ``bench train`` times: a recipe's own, and the plain one in a process of its own."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import torch
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from sfsnet_dr.base.checks import WorkFailed
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.dataset import RelitFaces, load_faces
from sfsnet_dr.data.light_bank import draw_bank
from sfsnet_dr.fit.recipe import ComputeRecipe, Recipe
from sfsnet_dr.fit.step import training_step
from sfsnet_dr.fit.team import Team, join

#: Lights that images are relit by; their number matters to no time.
_LIGHTS: Final = 64
#: Rows and columns of the matrices whose product shows the peak; larger ones are no faster.
PRODUCT_SIZE: Final = 2048
#: Seconds that a process has to end.
_PATIENCE: Final = 10.0


def relit_faces(recipe: Recipe, data: Path, team: Team) -> RelitFaces:
    """The batches of a recipe, under a few of its lights."""
    faces = load_faces(data, recipe.data.view).to(team.device)
    bank = draw_bank(recipe.data.light, min(_LIGHTS, recipe.data.lights), recipe.seed)
    return RelitFaces(faces, recipe.batch_size, recipe.data, recipe.seed, bank)


def plainly(recipe: Recipe) -> Recipe:
    """The recipe in float32, with torch's memory order and loss."""
    compute = ComputeRecipe(
        "float32", channels_last=False, loss_backend="torch", device=recipe.compute.device
    )
    return replace(recipe, compute=compute)


def stepper(recipe: Recipe, batch: FaceBatch, team: Team) -> Callable[[], Any]:
    """What makes one step of a fresh network after another."""
    model = recipe.make_model()
    team.prepare(model)
    layout = torch.channels_last if recipe.compute.channels_last else torch.contiguous_format
    model.to(memory_format=layout)  # type: ignore[call-overload]
    adam = torch.optim.Adam(model.parameters())
    return finished(lambda: training_step(model, adam, batch, recipe, 1e-4, team), team)


def finished(call: Callable[[], Any], team: Team) -> Callable[[], Any]:
    """The call, waited for: a GPU is given work faster than it does it."""
    if team.device.type != "cuda":
        return call

    def waited() -> None:
        call()
        torch.cuda.synchronize()

    return waited


def products(recipe: Recipe, image: Tensor, team: Team) -> int:
    """Multiplications and additions of the convolutions and products of one step on a batch of images."""
    model = recipe.make_model()
    team.prepare(model)
    with FlopCounterMode(display=False) as counter:
        torch.stack([part.sum() for part in model(image)]).sum().backward()  # type: ignore[no-untyped-call]
    return int(counter.get_total_flops())


def large_product(recipe: Recipe, team: Team) -> Callable[[], Any]:
    """The product of two large matrices in the precision of a recipe's step."""
    kind = torch.bfloat16 if recipe.compute.bfloat16(team.device) else torch.float32
    left, right = torch.rand(2, PRODUCT_SIZE, PRODUCT_SIZE, device=team.device).to(kind)
    return finished(lambda: left @ right, team)


class StepsApart:
    """Steps of a recipe in a process of its own, whose memory is torch's and the C library's own affair.

    Calling it makes one step. A context manager; the process ends with it.

    Raises:
        WorkFailed: when called, if the process has ended.
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
            raise WorkFailed("bench train: the process of the plain steps ended; see above") from error

    def __enter__(self) -> StepsApart:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pipe.close()  # which ends its loop
        self._process.join(_PATIENCE)
        self._process.kill()


def _serve(pipe: Connection, recipe: Recipe, data: Path) -> None:
    with join(recipe.compute.device) as team:
        step = stepper(recipe, relit_faces(recipe, data, team).batch(0), team)
        while True:
            try:
                pipe.recv()
            except EOFError:
                return
            step()
            pipe.send(None)
