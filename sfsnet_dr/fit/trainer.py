"""The training loop: batches, loss, Adam, a history, checkpoints and an exact resume."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from sfsnet_dr.base.atomic import output_dir
from sfsnet_dr.base.checks import BadInput, WorkFailed
from sfsnet_dr.base.config import as_dict
from sfsnet_dr.data.dataset import Folders, RelitFaces, load_faces
from sfsnet_dr.data.light_bank import LightBank, kept_bank
from sfsnet_dr.data.mixture import MixedFaces, RealFaces
from sfsnet_dr.data.pseudo_labels import load_pseudo_labels
from sfsnet_dr.fit.checkpoint import Progress, load_checkpoint, save_checkpoint
from sfsnet_dr.fit.collapse import PARTS, Watch
from sfsnet_dr.fit.history import History, read_history
from sfsnet_dr.fit.recipe import Recipe
from sfsnet_dr.fit.signals import StopRequest
from sfsnet_dr.fit.step import NotFinite, training_step
from sfsnet_dr.model.weights import save_weights

#: Files of a run's folder.
WEIGHTS: Final = "weights.safetensors"
CHECKPOINT: Final = "checkpoint.safetensors"
HISTORY: Final = "history.jsonl"
LIGHTS: Final = "lights.npz"

_TERMS: Final = (
    "total", "recon", "normal", "albedo", "light", "real_recon", "real_normal", "real_albedo", "real_light",
)  # fmt: skip

#: Steps that ``first`` and ``final`` of a result are means over.
WINDOW: Final = 20


@dataclass(frozen=True)
class TrainResult:
    """What a run leaves.

    Args:
        weights: the network, for ``load_weights``.
        history: a line for every step, for ``read_history``.
        first: means over the first ``WINDOW`` steps of total, recon, normal, albedo and light, and of
            real_recon and so on where photographs took part.
        final: the same over the last ``WINDOW`` steps.
        skipped: steps whose loss or gradient was not finite.
    """

    weights: Path
    history: Path
    first: dict[str, float]
    final: dict[str, float]
    skipped: int


def train(
    recipe: Recipe,
    data: Folders,
    out: Path | str,
    *,
    labels: Path | str | None = None,
    resume: bool = False,
    progress: bool = True,
) -> TrainResult:
    """Train a network on bundles, relit on the fly.

    Args:
        recipe: everything that decides the result; it is stored with the weights.
        data: folder with ``manifest.jsonl``, or several.
        out: folder for weights, history and checkpoint; made if missing.
        labels: folder of pseudo-labelled photographs, needed where the recipe's ``real.share`` is above 0.
        resume: go on from the checkpoint in ``out``. On one machine with one number of threads this gives
            the same bits as a run that was never stopped.
        progress: show a bar with the loss, images a second and the time left.

    Raises:
        BadInput: for unusable data, an ``out`` that holds a run while ``resume`` is false, or a checkpoint of
            another recipe or other data.
        WorkFailed: if too many steps were not finite, or SIGTERM came; the checkpoint is saved then.
        KeyboardInterrupt: on SIGINT, with the checkpoint saved.
    """
    real = _real_faces(recipe, labels)
    faces = load_faces(data, recipe.data.size, held_back=recipe.data.held_back)
    folder = output_dir(out)
    if not resume and (folder / CHECKPOINT).exists():
        raise BadInput(f"{folder}: holds a run already; go on with --resume or choose another folder")
    bank = _bank(recipe, folder, progress)
    rendered = recipe.batch_size - recipe.real.count(recipe.batch_size)
    batches = RelitFaces(faces, rendered, recipe.data, recipe.seed, bank)
    run = _Run(recipe, batches if real is None else MixedFaces(batches, real), folder, resume)
    with _bar(progress) as bar, StopRequest() as stop, History(folder / HISTORY, run.done.step) as history:
        task = bar.add_task("training", total=recipe.steps, completed=run.done.step, loss="", speed="")
        while run.done.step < recipe.steps:
            loss, speed = run.step(history)
            bar.update(task, advance=1, loss=loss, speed=speed)
            if stop.received:
                run.save()
                _raise_stopped(stop.received, folder, run.done.step)
    return run.finish()


class _Run:
    """A run's changing state: the network, Adam and how far it is."""

    def __init__(self, recipe: Recipe, batches: RelitFaces | MixedFaces, folder: Path, resume: bool) -> None:
        self.recipe, self.folder, self.batches = recipe, folder, batches
        self.data = batches.fingerprint
        self.watch = Watch()
        self.model = recipe.make_model()
        layout = torch.channels_last if recipe.compute.channels_last else torch.contiguous_format
        self.model.to(memory_format=layout)  # type: ignore[call-overload]
        decay = recipe.optimiser.weight_decay
        self.adam = torch.optim.Adam(self.model.parameters(), weight_decay=decay)
        self.done = Progress()
        if resume:
            self.done = load_checkpoint(folder / CHECKPOINT, self.model, self.adam, recipe, self.data)
            self._look_back()

    def _look_back(self) -> None:
        """Show the watch what it saw before, so that a resumed run warns where an unstopped one would."""
        for line in read_history(self.folder / HISTORY):
            if line["step"] < self.done.step and "skipped" not in line:
                self.watch.see(_spreads(line))

    def step(self, history: History) -> tuple[str, str]:
        """Do the next step, note it, and give the bar its texts: loss and speed."""
        number = self.done.step
        started = time.perf_counter()
        rate = self.recipe.optimiser.rate(number, self.recipe.steps)
        try:
            batch = self.batches.batch(number)
            values = training_step(self.model, self.adam, batch, self.recipe, rate)
            speed = self.recipe.batch_size / (time.perf_counter() - started)
            warning = self.watch.see(_spreads(values))
            more = {"warning": warning} if warning else {}
            history.add(step=number, rate=rate, **values, **more, images_per_second=round(speed, 2))
            if warning:
                Console(stderr=True).print(f"step {number}: {warning}", style="yellow", soft_wrap=True)
            texts = f"loss {values['total']:.4f}", f"{speed:.1f} images/s"
            self.done = replace(self.done, step=number + 1)
        except NotFinite as error:
            names = self.batches.names(number)
            history.add(step=number, rate=rate, skipped=str(error), faces=names)
            texts = f"skipped: {error}", ""
            self.done = Progress(number + 1, self.done.skipped + 1)
            self._check_skipped(str(error), names)
        if self.done.step % self.recipe.checkpoint_every == 0:
            self.save()
        return texts

    def save(self) -> None:
        """Write the checkpoint."""
        save_checkpoint(self.folder / CHECKPOINT, self.model, self.adam, self.done, self.recipe, self.data)

    def finish(self) -> TrainResult:
        """Write the weights and sum up."""
        self.save()
        lines = [line for line in read_history(self.folder / HISTORY) if "skipped" not in line]
        first, final = _means(lines[:WINDOW]), _means(lines[-WINDOW:])
        metadata = {"recipe": as_dict(self.recipe), "data": self.data, "final": final}
        save_weights(self.folder / WEIGHTS, self.model, metadata)
        return TrainResult(self.folder / WEIGHTS, self.folder / HISTORY, first, final, self.done.skipped)

    def _check_skipped(self, reason: str, names: list[str]) -> None:
        if self.done.skipped > self.recipe.most_skipped:
            self.save()
            raise WorkFailed(
                f"training: {self.done.skipped} steps were not finite ({self.recipe.most_skipped} allowed); "
                f"the last, {self.done.step - 1}, had {reason} on {', '.join(names)}; lower the learning rate"
            )


def _real_faces(recipe: Recipe, labels: Path | str | None) -> RealFaces | None:
    count = recipe.real.count(recipe.batch_size)
    if (labels is None) != (count == 0):
        found = "no folder of labels" if labels is None else f"the labels of {labels}"
        raise BadInput(
            f"real.share: {recipe.real.share:g} in the recipe and {found} found; a share above 0 and "
            "--labels DIR (see `sfsnet-dr pseudo-label`) belong together"
        )
    return None if labels is None else RealFaces(load_pseudo_labels(labels), count, recipe.real, recipe.seed)


def _bank(recipe: Recipe, folder: Path, progress: bool) -> LightBank:
    wanted = recipe.data
    with _bar(progress, transient=True) as bar:
        task = bar.add_task("drawing lights", total=wanted.lights, loss="", speed="")
        return kept_bank(folder / LIGHTS, wanted.light, wanted.lights, recipe.seed, lambda: bar.advance(task))


def _spreads(values: dict[str, Any]) -> dict[str, float]:
    return {name: values[f"{name}_spread"] for name in PARTS}


def _means(lines: list[dict[str, Any]]) -> dict[str, float]:
    names = [name for name in _TERMS if lines and name in lines[0]]
    return {name: sum(line[name] for line in lines) / len(lines) for name in names}


def _raise_stopped(number: signal.Signals, folder: Path, step: int) -> None:
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise WorkFailed(f"training: {number.name} after {step} steps; {folder} is saved, go on with --resume")


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
