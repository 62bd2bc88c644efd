"""The whole state of a training run in one file, so that going on is the same as never having stopped.

A checkpoint is one safetensors file: the network's tensors under ``model.``, Adam's under ``adam.``, and as
JSON in its header the step, the number of skipped steps, the recipe and the fingerprint of the data. No
generator's state is in it: batches and learning rates are functions of the step (see ``RelitFaces``).
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from sfsnet_dr.core.config import as_dict
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import atomic_path
from sfsnet_dr.train.config import Recipe

FORMAT: Final = "sfsnet_dr.checkpoint.1"

#: Adam's tensors of each parameter.
_ADAM: Final = ("step", "exp_avg", "exp_avg_sq")


@dataclass(frozen=True)
class Progress:
    """How far a run is: the next step, and the steps skipped so far."""

    step: int = 0
    skipped: int = 0


def save_checkpoint(
    path: Path,
    model: nn.Module,
    adam: torch.optim.Adam,
    progress: Progress,
    recipe: Recipe,
    data: str,
    start: str | None = None,
) -> None:
    """Write the state, whole or not at all; what the file was stays beside it, see ``previous_path``.

    ``start`` is the SHA-256 of the weights that the run began with, if it did not begin with random ones.
    """
    tensors = {f"model.{name}": tensor for name, tensor in model.state_dict().items()}
    for name, parameter in model.named_parameters():
        for part, tensor in adam.state.get(parameter, {}).items():
            tensors[f"adam.{part}.{name}"] = tensor
    header = {
        "format": FORMAT,
        "step": progress.step,
        "skipped": progress.skipped,
        "recipe": as_dict(recipe),
        "data": data,
        "start": start,
    }
    plain = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    with atomic_path(path) as partial:
        save_file(plain, partial, {"sfsnet_dr": json.dumps(header, sort_keys=True)})
        if path.exists():  # a second name for it first, so that at no moment there is none
            older = partial.with_name(f"{partial.name}.older")
            os.link(path, older)
            os.replace(older, previous_path(path))


def previous_path(path: Path) -> Path:
    """Where the checkpoint before the last one is kept."""
    return path.with_name(f"{path.stem}.previous{path.suffix}")


def load_checkpoint(
    path: Path,
    model: nn.Module,
    adam: torch.optim.Adam,
    recipe: Recipe,
    data: str,
    start: str | None = None,
    tell: Callable[[str], object] = lambda _: None,
) -> Progress:
    """Put a saved state into a network and its optimiser, both freshly made from the same recipe.

    Where the file is damaged, the one before it is taken and ``tell`` is told.

    Raises:
        InputError: if there is no checkpoint, or it is of another recipe, other data, start or
            format.
    """
    if not path.is_file():
        raise InputError(f"{path}: no checkpoint to resume from; start without --resume")
    try:
        header, tensors = _read(path)
    except InputError as damage:
        if not previous_path(path).is_file():
            raise
        tell(f"{damage}; going on from {previous_path(path).name}")
        header, tensors = _read(previous_path(path))
    if header.get("format") != FORMAT:
        raise InputError(f"{path}: {header.get('format')} found in its header, {FORMAT} expected")
    _check_same(path, header, recipe, data, start)
    model.load_state_dict(_part(tensors, "model."))
    for name, parameter in model.named_parameters():
        adam.state[parameter] = _adam_state(tensors, name, parameter)
    return Progress(header["step"], header["skipped"])


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    try:
        with safe_open(path, framework="pt") as file:
            header = json.loads((file.metadata() or {}).get("sfsnet_dr", "{}"))
            return header, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path}: not a checkpoint ({' '.join(str(error).split())})") from error


def _part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): t for name, t in tensors.items() if name.startswith(prefix)}


def _adam_state(tensors: dict[str, Tensor], name: str, parameter: Tensor) -> dict[str, Tensor]:
    """Adam's moments in the parameter's memory order; its step count stays a scalar on the CPU."""
    state = {part: tensors[f"adam.{part}.{name}"] for part in _ADAM if f"adam.{part}.{name}" in tensors}
    return {
        part: torch.zeros_like(parameter).copy_(tensor) if tensor.shape == parameter.shape else tensor
        for part, tensor in state.items()
    }


def _check_same(path: Path, header: dict[str, Any], recipe: Recipe, data: str, start: str | None) -> None:
    if header["data"] != data:
        raise InputError(
            f"{path}: trained on other bundles or environment maps; resume with the same, or choose another "
            "--out"
        )
    if header.get("start") != start:
        raise InputError(
            f"{path}: begun with {_weights(header.get('start'))}, {_weights(start)} given; resume with the "
            "same --start"
        )
    for where, found, wanted in find_differences(header["recipe"], as_dict(recipe)):
        raise InputError(
            f"{path}: recipe with {where} = {found!r} found, {wanted!r} asked for; use the same recipe"
        )


def _weights(digest: str | None) -> str:
    return "random weights" if digest is None else f"weights of SHA-256 {digest[:12]}"


def find_differences(a: Any, b: Any, where: str = "") -> list[tuple[str, Any, Any]]:
    """Where two nested dictionaries differ: dotted key, value in the first, value in the second."""
    if not (isinstance(a, dict) and isinstance(b, dict)):
        return [] if a == b else [(where, a, b)]
    keys = sorted(a.keys() | b.keys())
    return [d for key in keys for d in find_differences(a.get(key), b.get(key), f"{where}.{key}".lstrip("."))]
