"""A training run's changing state, and everything that it writes."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import torch
from rich.console import Console
from safetensors import SafetensorError

from sfsnet_dr.core.config import as_dict
from sfsnet_dr.core.errors import RunError
from sfsnet_dr.core.provenance import sha256
from sfsnet_dr.data.dataset import RelitFaces
from sfsnet_dr.data.mixed_batch import MixedFaces
from sfsnet_dr.models.shipped import weights_path
from sfsnet_dr.models.weights import copy_weights, save_weights
from sfsnet_dr.train.checkpoint import Progress, load_checkpoint, save_checkpoint
from sfsnet_dr.train.config import Recipe
from sfsnet_dr.train.distributed import ProcessGroup
from sfsnet_dr.train.logging import History, TensorBoardLogger, read_history, write_sample_images
from sfsnet_dr.train.step import PARTS, CollapseMonitor, NonFiniteError, training_step

#: Files of a run's folder.
WEIGHTS: Final = "weights.safetensors"
CHECKPOINT: Final = "checkpoint.safetensors"
HISTORY: Final = "history.jsonl"
LIGHTS: Final = "lights.npz"
PICTURES: Final = "pictures-{:06d}.png"

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


class TrainingRun:
    """The network, Adam and how far a run is. Of a team the leading process alone writes files.

    Args:
        recipe: of the run.
        batches: what it learns from, on the team's device.
        folder: for all files.
        resume: go on from the checkpoint in the folder.
        team: the processes that train together.
        tensorboard: write for TensorBoard too.
        start: weights to begin with in place of random ones.
        metadata: more that the weights should tell.

    Raises:
        InputError: for unusable weights, those of another network, or a checkpoint of another run.
    """

    def __init__(
        self,
        recipe: Recipe,
        batches: RelitFaces | MixedFaces,
        folder: Path,
        *,
        resume: bool,
        team: ProcessGroup,
        tensorboard: bool,
        start: Path | None = None,
        metadata: Mapping[str, Any] | None = None,
    ) -> None:
        self.recipe, self.folder, self.batches, self.team = recipe, folder, batches, team
        self.data = batches.fingerprint
        self.watch = CollapseMonitor()
        self.metadata = dict(metadata or {})
        self.model = recipe.make_model()
        self.start = None if start is None else sha256(weights_path(start))
        if start is not None and not resume:
            copy_weights(start, self.model)
        team.prepare(self.model)
        layout = torch.channels_last if recipe.compute.channels_last else torch.contiguous_format
        self.model.to(memory_format=layout)  # type: ignore[call-overload]
        decay = recipe.optimiser.weight_decay
        self.adam = torch.optim.Adam(self.model.parameters(), weight_decay=decay)
        self.done = Progress()
        self._screen = Console(stderr=True, quiet=not team.is_main_process)
        if resume:
            checkpoint = folder / CHECKPOINT
            self.done = load_checkpoint(
                checkpoint, self.model, self.adam, recipe, self.data, self.start, tell=self._tell
            )
            self._look_back()
        self._board = (
            TensorBoardLogger(folder, self.done.step) if tensorboard and team.is_main_process else None
        )
        team.wait()  # all have read what the leading one is about to change
        self._history = History(folder / HISTORY, self.done.step) if team.is_main_process else None

    def _look_back(self) -> None:
        """Show the watch what it saw before, so that a resumed run warns where an unstopped one would."""
        for line in read_history(self.folder / HISTORY):
            if line["step"] < self.done.step and "skipped" not in line:
                self.watch.see(_spreads(line))

    def close(self) -> None:
        """Close what is open."""
        if self._history is not None:
            self._history.close()
        if self._board is not None:
            self._board.close()

    def step(self) -> tuple[str, str]:
        """Do the next step, note it, and give the bar its texts: loss and speed.

        Raises:
            RunError: if too many steps were not finite, or nothing can be written any more.
        """
        number = self.done.step
        started = time.perf_counter()
        rate = self.recipe.optimiser.rate(number, self.recipe.steps)
        try:
            batch = self.batches.batch(number, self.team.rank, self.team.size)
            values = training_step(self.model, self.adam, batch, self.recipe, rate, self.team)
            speed = self.recipe.batch_size / (time.perf_counter() - started)
            warning = self.watch.see(_spreads(values))
            more = {"warning": warning} if warning else {}
            self._note(step=number, rate=rate, **values, **more, images_per_second=round(speed, 2))
            if warning:
                self._tell(f"step {number}: {warning}")
            texts = f"loss {values['total']:.4f}", f"{speed:.1f} images/s"
            self.done = replace(self.done, step=number + 1)
        except NonFiniteError as error:
            names = self.batches.names(number)
            self._note(step=number, rate=rate, skipped=str(error), faces=names)
            self._tell(f"step {number}: skipped, {error} on {', '.join(names)}")
            texts = f"skipped: {error}", ""
            self.done = Progress(number + 1, self.done.skipped + 1)
            self._check_skipped(str(error), names)
        if self.done.step % self.recipe.checkpoint_every == 0:
            self.save()
        every = self.recipe.log_images_every
        if every and self.done.step % every == 0 and self.team.is_main_process:
            path = self.folder / PICTURES.format(self.done.step)
            write_sample_images(path, self.model, self.batches.batch(0), self.recipe.real.encoding)
        return texts

    def save(self) -> None:
        """Write the checkpoint; the one before stays beside it.

        Raises:
            RunError: if it cannot be written, as on a full disk; the last one is whole then.
        """
        if not self.team.is_main_process:
            return
        path = self.folder / CHECKPOINT
        try:
            save_checkpoint(path, self.model, self.adam, self.done, self.recipe, self.data, self.start)
        except (OSError, SafetensorError) as error:
            raise self._unwritable(path, error) from error

    def finish(self) -> TrainResult:
        """Write the weights and sum up."""
        self.save()
        self.team.wait()
        lines = [line for line in read_history(self.folder / HISTORY) if "skipped" not in line]
        first, final = _means(lines[:WINDOW]), _means(lines[-WINDOW:])
        metadata = {"recipe": as_dict(self.recipe), "data": self.data, "start": self.start, "final": final}
        metadata |= self.metadata
        path = self.folder / WEIGHTS
        if self.team.is_main_process:
            try:
                save_weights(path, self.model, metadata)
            except (OSError, SafetensorError) as error:
                raise self._unwritable(path, error) from error
        self.team.wait()
        return TrainResult(path, self.folder / HISTORY, first, final, self.done.skipped)

    def _note(self, **values: Any) -> None:
        if self._history is not None:
            try:
                self._history.add(**values)
            except OSError as error:
                raise self._unwritable(self.folder / HISTORY, error) from error
        if self._board is not None:
            self._board.add(values["step"], values)

    def _tell(self, text: str) -> None:
        self._screen.print(text, style="yellow", soft_wrap=True, markup=False)

    def _unwritable(self, path: Path, error: Exception) -> RunError:
        reason = " ".join(str(error).split())
        return RunError(
            f"{path}: cannot be written ({reason}); the last checkpoint is whole: make room and go on with "
            "--resume"
        )

    def _check_skipped(self, reason: str, names: list[str]) -> None:
        if self.done.skipped > self.recipe.max_skipped_steps:
            self.save()
            raise RunError(
                f"training: {self.done.skipped} steps were not finite ({self.recipe.max_skipped_steps} "
                f"allowed); the last, {self.done.step - 1}, had {reason} on {', '.join(names)}; "
                "lower the learning rate"
            )


def _spreads(values: dict[str, Any]) -> dict[str, float]:
    return {name: values[f"{name}_spread"] for name in PARTS}


def _means(lines: list[dict[str, Any]]) -> dict[str, float]:
    names = [name for name in _TERMS if lines and name in lines[0]]
    return {name: sum(line[name] for line in lines) / len(lines) for name in names}
