"""Weights files: safetensors that say which network they are of, and eight-bit quantization.

Every tensor of two dimensions and more becomes int8 with one float16 step for each index of its first axis.
The largest magnitude there is 127 steps, so a weight is wrong by half a step at most, 0.4 % of the largest
beside it. Biases, batch normalisation and its statistics are small and stay as they are.

Trained networks that come with the package, by name; ``sfsnet_dr/weights/NAME.md`` is the card of each.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from sfsnet_dr.core.errors import InputError, nearest
from sfsnet_dr.core.files import atomic_path
from sfsnet_dr.models.base import Network
from sfsnet_dr.models.sfsnet import SfSNet
from sfsnet_dr.models.shipped import weights_path
from sfsnet_dr.models.skipnet import SkipNet, SkipNetPlus

#: Ends the names of the steps, which stand beside the tensors that they belong to.
STEP: Final = ":step"

_LARGEST: Final = 127


def to_eight_bit(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Tensors as they are kept, the steps among them."""
    kept: dict[str, Tensor] = {}
    for name, tensor in tensors.items():
        if tensor.ndim < 2 or not tensor.is_floating_point():
            kept[name] = tensor
            continue
        largest = tensor.abs().flatten(1).amax(1)
        # Rounded up to half precision, so that no weight needs more than 127 steps.
        step = torch.nextafter((largest / _LARGEST).half(), torch.tensor(torch.inf, dtype=torch.float16))
        kept[name] = (tensor / _beside(step, tensor)).round().to(torch.int8)
        kept[name + STEP] = step
    return kept


def from_eight_bit(kept: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Float32 tensors of what ``to_eight_bit`` gave; what has no step stays as it is."""
    return {
        name: tensor.float() * _beside(kept[name + STEP], tensor) if name + STEP in kept else tensor
        for name, tensor in kept.items()
        if not name.endswith(STEP)
    }


def _beside(step: Tensor, tensor: Tensor) -> Tensor:
    return step.float().reshape(-1, *(1,) * (tensor.ndim - 1))


#: Architectures by the name that files and recipes use.
ARCHITECTURES: Final[dict[str, type[Network]]] = {
    kind.architecture: kind for kind in (SfSNet, SkipNet, SkipNetPlus)
}

FORMAT: Final = "sfsnet_dr.weights"
VERSION: Final = 1

#: The one metadata key: safetensors does not keep the order of several, and bytes should repeat.
HEADER: Final = "sfsnet_dr"


def network_settings(architecture: str) -> dict[str, int]:
    """The settings that an architecture has, with their defaults: the paper's.

    Raises:
        InputError: for an unknown name.
    """
    if architecture not in ARCHITECTURES:
        raise InputError(f"architecture: {architecture!r} found; {nearest(architecture, ARCHITECTURES)}")
    parameters = inspect.signature(ARCHITECTURES[architecture]).parameters
    return {name: parameter.default for name, parameter in parameters.items()}


def build_network(architecture: str, config: Mapping[str, int]) -> Network:
    """A freshly initialised network by name.

    Raises:
        InputError: for an unknown name or an unknown configuration key.
    """
    known = network_settings(architecture)
    for key in config:
        if key not in known:
            raise InputError(f"{architecture} configuration: unknown key {key!r}; {nearest(key, known)}")
    kind: Callable[..., Network] = ARCHITECTURES[architecture]
    return kind(**config)


def save_weights(
    path: Path | str, model: Network, metadata: Mapping[str, Any] | None = None, *, eight_bit: bool = False
) -> None:
    """Write parameters and batch-normalisation statistics, whole or not at all.

    Args:
        path: the file, by custom ``*.safetensors``.
        model: the network.
        metadata: anything JSON can hold that should travel along: recipe, step, losses, versions.
        eight_bit: keep what is large in a quarter of the bytes, see ``model.eight_bit``.
    """
    header = {
        "format": FORMAT,
        "version": VERSION,
        "architecture": model.architecture,
        "config": model.config,
        "metadata": dict(metadata or {}),
    }
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in model.state_dict().items()}
    if eight_bit:
        tensors = to_eight_bit(tensors)
    with atomic_path(path) as partial:
        save_file(tensors, partial, {HEADER: json.dumps(header, sort_keys=True)})


def load_weights(path: Path | str) -> Network:
    """The network that a file of ``save_weights`` holds, in evaluation mode, on the CPU.

    ``path`` may be the name of a shipped network, here and below.

    Raises:
        InputError: if the file is missing, is no weights file, is of another version or architecture, or
            does not hold the tensors that its architecture needs.
    """
    path = weights_path(path)
    header, tensors = _read(path)
    model = _fitting(path, header)
    _fill(path, model, tensors)
    return model.eval()


def copy_weights(path: Path | str, model: Network) -> None:
    """Put the weights of a file into a network of the same architecture and settings.

    Raises:
        InputError: as ``load_weights``, or if the file holds another network.
    """
    path = weights_path(path)
    header, tensors = _read(path)
    found, wanted = (header["architecture"], header["config"]), (model.architecture, model.config)
    if found != wanted:
        raise InputError(f"{path}: a {_told(*found)} found, a {_told(*wanted)} is to begin with it")
    _fill(path, model, tensors)


def read_metadata(path: Path | str) -> dict[str, Any]:
    """What ``save_weights`` was given as ``metadata``."""
    header, _ = _read(weights_path(path), header_only=True)
    metadata: dict[str, Any] = header.get("metadata", {})
    return metadata


def _read(path: Path, header_only: bool = False) -> tuple[dict[str, Any], dict[str, Tensor]]:
    if not path.is_file():
        raise InputError(f"{path}: no such file; give weights that `sfsnet-dr train` wrote")
    try:
        with safe_open(path, framework="pt") as file:
            text = (file.metadata() or {}).get(HEADER)
            tensors = {} if header_only else {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise InputError(
            f"{path}: not a safetensors file ({_line(error)}); weights have this format"
        ) from error
    header: dict[str, Any] = json.loads(text) if text else {}
    if header.get("format") != FORMAT:
        found = header.get("format", "no format name")
        raise InputError(
            f"{path}: {found} found in its header, {FORMAT} expected; `sfsnet-dr train` writes it"
        )
    if header["version"] != VERSION:
        raise InputError(f"{path}: weights of format version {header['version']} found, {VERSION} expected")
    return header, from_eight_bit(tensors)


def _fitting(path: Path, header: dict[str, Any]) -> Network:
    try:
        return build_network(header["architecture"], header["config"])
    except InputError as error:
        raise InputError(f"{path}: weights of another network: {error}") from error


def _fill(path: Path, model: nn.Module, tensors: dict[str, Tensor]) -> None:
    wanted = model.state_dict()
    for name in sorted(wanted.keys() ^ tensors.keys()):
        what = "is missing" if name in wanted else "is not part of the network"
        raise InputError(
            f"{path}: tensor {name!r} {what}; the file does not hold the network its header names"
        )
    for name, tensor in wanted.items():
        if tensor.shape != tensors[name].shape:
            found, allowed = tuple(tensors[name].shape), tuple(tensor.shape)
            raise InputError(f"{path}: tensor {name!r} has shape {found}, {allowed} expected")
    model.load_state_dict(tensors)


def _told(architecture: str, config: Mapping[str, int]) -> str:
    return f"{architecture} with {', '.join(f'{key} = {value}' for key, value in sorted(config.items()))}"


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
