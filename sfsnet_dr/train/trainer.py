"""Training from data to weights, in one process or several, stopped cleanly by signals."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from sfsnet_dr.core.errors import InputError, RunError
from sfsnet_dr.core.files import output_dir
from sfsnet_dr.core.host import keep_freed_memory
from sfsnet_dr.data.batch import shard
from sfsnet_dr.data.dataset import Faces, Folders, RelitFaces, load_faces
from sfsnet_dr.data.mixed_batch import MixedFaces
from sfsnet_dr.scene.lights.cache import LightCache, load_or_draw_lights
from sfsnet_dr.train.config import Recipe
from sfsnet_dr.train.distributed import ProcessGroup, join_process_group
from sfsnet_dr.train.run import CHECKPOINT, LIGHTS, TrainingRun, TrainResult
from sfsnet_dr.train.sources import RealSources, configure_sources


class StopRequest:
    """While the block runs, SIGTERM and SIGINT only set ``received``; a second one acts as it used to.

    Outside the main thread, where Python allows no handlers, nothing is caught.
    """

    def __init__(self) -> None:
        self.received: signal.Signals | None = None
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGTERM, signal.SIGINT):
                self._before[number] = signal.signal(number, self._receive)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._restore()

    def _receive(self, number: int, _frame: FrameType | None) -> None:
        self.received = signal.Signals(number)
        self._restore()

    def _restore(self) -> None:
        while self._before:
            number, handler = self._before.popitem()
            signal.signal(number, handler)


def train(
    recipe: Recipe,
    data: Folders,
    out: Path | str,
    *,
    labels: Path | str | None = None,
    surfaces: Path | str | None = None,
    resume: bool = False,
    progress: bool = True,
    tensorboard: bool = False,
    start: Path | None = None,
) -> TrainResult:
    """Train a network on bundles, relit on the fly.

    Args:
        recipe: everything that decides the result; it is stored with the weights.
        data: folder with ``manifest.jsonl``, or several.
        out: folder for weights, history and checkpoint; made if missing.
        labels: folder of pseudo-labelled photographs, needed where the recipe's ``real.batch_fraction`` is
            above 0.
        surfaces: folder of labels by photometric stereo, needed where ``normal_labels.batch_fraction`` is
            above 0; who is held back is stored with the weights.
        resume: go on from the checkpoint in ``out``. On one machine with one number of threads this gives
            the same bits as a run that was never stopped.
        progress: show a bar with the loss, images a second and the time left.
        tensorboard: write the history for TensorBoard too.
        start: weights of the same network to begin with; a resumed run needs the same.

    Raises:
        InputError: for unusable data or weights, an ``out`` that holds a run while ``resume`` is false, or a
            checkpoint of another recipe, other data or another start.
        RunError: if too many steps were not finite, or SIGTERM came; the checkpoint is saved then.
        KeyboardInterrupt: on SIGINT, with the checkpoint saved.
    """
    real = configure_sources(recipe, labels, surfaces, start)
    folder = output_dir(out)
    if not resume and (folder / CHECKPOINT).exists():
        raise InputError(f"{folder}: holds a run already; go on with --resume or choose another folder")
    faces = load_faces(data, recipe.data.view, held_back=recipe.data.num_val)
    with join_process_group(recipe.compute.device) as team:
        batches = _batches(recipe, faces, real, folder, team, progress)
        keep_freed_memory()  # from here on all steps need the same; what loading needed is given back
        run = TrainingRun(
            recipe, batches, folder, resume=resume, team=team, tensorboard=tensorboard, start=start,
            metadata=real.metadata,
        )  # fmt: skip
        with closing(run), StopRequest() as stop, _bar(progress and team.is_main_process) as bar:
            task = bar.add_task("training", total=recipe.steps, completed=run.done.step, loss="", speed="")
            while run.done.step < recipe.steps:
                loss, speed = run.step()
                bar.update(task, advance=1, loss=loss, speed=speed)
                if team.any(stop.received is not None):
                    run.save()
                    _raise_stopped(stop.received, folder, run.done.step)
        return run.finish()


def _batches(
    recipe: Recipe, faces: Faces, real: RealSources, folder: Path, team: ProcessGroup, progress: bool
) -> RelitFaces | MixedFaces:
    """The batches of a recipe on a team's device; the leading process draws the lights for all."""
    rendered = recipe.batch_size - sum(real.counts)
    for images in (rendered, *real.counts):
        shard(images, team.rank, team.size)
    if team.is_main_process:
        bank = _bank(recipe, folder, progress)
    team.wait()
    bank = bank if team.is_main_process else _bank(recipe, folder, progress=False)
    relit = RelitFaces(faces.to(team.device), rendered, recipe.data, recipe.seed, bank)
    return relit if not real.sources else MixedFaces(relit, real.open(team.device))


def _bank(recipe: Recipe, folder: Path, progress: bool) -> LightCache:
    wanted = recipe.data
    with _bar(progress, transient=True) as bar:
        task = bar.add_task("drawing lights", total=wanted.num_lights, loss="", speed="")
        return load_or_draw_lights(
            folder / LIGHTS, wanted.light, wanted.num_lights, recipe.seed, lambda: bar.advance(task)
        )


def _raise_stopped(number: signal.Signals | None, folder: Path, step: int) -> None:
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    name = "another process was told to stop" if number is None else number.name
    raise RunError(f"training: {name} after {step} steps; {folder} is saved, go on with --resume")


@contextmanager
def _bar(shown: bool, transient: bool = False) -> Iterator[Bar]:
    console = Console(stderr=True)  # standard output belongs to the command's result
    bar = Bar(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[loss]}"),
        TextColumn("{task.fields[speed]}"),
        TimeRemainingColumn(),
        console=console,
        disable=not shown or (transient and not console.is_interactive),
        transient=transient,
    )
    with bar:
        try:
            yield bar
        except BaseException:
            bar.live.transient = True  # the line that tells the failure stands alone, also in a log
            bar.console.quiet = not bar.console.is_interactive
            raise
