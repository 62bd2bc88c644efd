"""A training recipe: every number that decides a run, read from TOML and stored with its result."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Final, Literal

import torch

from sfsnet_dr.core.config import added_field, load_toml
from sfsnet_dr.core.conventions import FACE_SIZE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.mixed_batch import PseudoLabelOptions
from sfsnet_dr.data.normal_dataset import NormalLabelOptions
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.losses.reconstruction import Backend
from sfsnet_dr.losses.sfsnet import LossWeights
from sfsnet_dr.models.base import Network
from sfsnet_dr.models.sfsnet import SfSNet
from sfsnet_dr.models.weights import build_network, network_settings
from sfsnet_dr.train.distributed import Device

Precision = Literal["auto", "float32", "bfloat16"]

_NO_SURFACES: Final = NormalLabelOptions()


@dataclass(frozen=True)
class ModelRecipe:
    """The network, by name and settings; those that are left out are the paper's.

    Args:
        architecture: its name.
        stem, features, blocks: of SfSNet.
        width: of SkipNet and SkipNet+.
    """

    architecture: str = SfSNet.architecture
    stem: int | None = None
    features: int | None = None
    blocks: int | None = None
    width: int | None = None

    @property
    def config(self) -> dict[str, int]:
        """The settings, as the network's constructor takes them.

        Raises:
            InputError: for an unknown architecture.
        """
        given = {name: getattr(self, name) for name in ("stem", "features", "blocks", "width")}
        return network_settings(self.architecture) | {k: v for k, v in given.items() if v is not None}

    def make(self, size: int = FACE_SIZE) -> Network:
        """A freshly initialised network for images of ``size`` pixels square.

        Raises:
            InputError: for a setting that the architecture does not have, or a size that it cannot take.
        """
        config = self.config
        return build_network(self.architecture, config | ({"size": size} if "size" in config else {}))


@dataclass(frozen=True)
class OptimiserRecipe:
    """Adam with linear warm-up and a cosine to ``last_share`` of the learning rate.

    Args:
        learning_rate: the highest.
        warmup_steps: steps in which it grows from 0.
        final_lr_ratio: share of it that is left at the last step; 1 keeps it constant.
        weight_decay: L2 penalty as in Adam, 0 for none.
        max_grad_norm: norm above which a gradient is scaled down to it.
    """

    RENAMED: ClassVar[dict[str, str]] = {
        "warm_up": "warmup_steps",
        "last_share": "final_lr_ratio",
        "largest_gradient": "max_grad_norm",
    }

    learning_rate: float = 1e-3
    warmup_steps: int = 20
    final_lr_ratio: float = 0.01
    weight_decay: float = 0.0
    max_grad_norm: float = 1.0

    def __post_init__(self) -> None:
        _positive(self, "learning_rate", "max_grad_norm")
        _not_negative(self, "warmup_steps", "weight_decay")
        if not 0 <= self.final_lr_ratio <= 1:
            raise InputError(f"last_share: {self.final_lr_ratio} found, a share from 0 to 1 is needed")

    def rate(self, step: int, steps: int) -> float:
        """Learning rate of step 0..steps-1: a function of the step alone, so nothing is to be resumed."""
        if step < self.warmup_steps:
            return self.learning_rate * (step + 1) / (self.warmup_steps + 1)
        done = (step - self.warmup_steps) / max(steps - 1 - self.warmup_steps, 1)
        wave = 0.5 * (1 + math.cos(math.pi * done))
        return self.learning_rate * (self.final_lr_ratio + (1 - self.final_lr_ratio) * wave)


@dataclass(frozen=True)
class ComputeRecipe:
    """How the same numbers are computed.

    Args:
        precision: of the convolutions; the last layers, loss and weights are float32 always. "auto" takes
            bfloat16 (autocast) where the processor multiplies it itself, which is then three times as fast as
            float32. Elsewhere it is emulated, four times as slow.
        channels_last: memory order that CPU convolutions are quicker in.
        loss_backend: who computes the reconstruction term.
        device: "auto" takes a GPU if there is one; faces and photographs are then kept in its memory.
    """

    precision: Precision = "auto"
    channels_last: bool = True
    loss_backend: Backend = "drjit"
    device: Device = "auto"

    def bfloat16(self, device: torch.device) -> bool:
        """Whether a device trains in bfloat16."""
        return self.precision == "bfloat16" or (self.precision == "auto" and multiplies_bfloat16(device))


@dataclass(frozen=True)
class Recipe:
    """One training run.

    Args:
        steps: optimiser steps.
        batch_size: images a step.
        seed: of the initial weights and of every batch.
        checkpoint_every: steps between two checkpoints; the last step always writes one.
        log_images_every: steps between two pictures of what the network makes of a batch; 0 for none.
        max_skipped_steps: steps with a loss or gradient that is not finite before the run fails.
        model, data, optimiser, compute: the network, how rendered faces vary, Adam, and how it is computed.
        loss: weights of the terms; ``real_loss`` those of real faces.
        real: how photographs take part.
        normal_labels: how faces with labels by photometric stereo take part.

    Raises:
        InputError: for a value out of its range.
    """

    RENAMED: ClassVar[dict[str, str]] = {
        "pictures_every": "log_images_every",
        "most_skipped": "max_skipped_steps",
        "surfaces": "normal_labels",
    }

    steps: int
    batch_size: int = 8
    seed: int = 0
    checkpoint_every: int = 100
    log_images_every: int = 0
    max_skipped_steps: int = 10
    model: ModelRecipe = field(default_factory=ModelRecipe)
    data: Augmentation = field(default_factory=Augmentation)
    loss: LossWeights = field(default_factory=LossWeights)
    real: PseudoLabelOptions = field(default_factory=PseudoLabelOptions)
    real_loss: LossWeights = field(default_factory=LossWeights)
    normal_labels: NormalLabelOptions = added_field(_NO_SURFACES)  # noqa: RUF009 (frozen)
    optimiser: OptimiserRecipe = field(default_factory=OptimiserRecipe)
    compute: ComputeRecipe = field(default_factory=ComputeRecipe)

    def __post_init__(self) -> None:
        _positive(self, "steps", "batch_size", "checkpoint_every")
        _not_negative(self, "seed", "max_skipped_steps", "log_images_every")
        photographs, captures = self.real.count(self.batch_size), self.normal_labels.count(self.batch_size)
        if photographs + captures >= self.batch_size:
            raise InputError(
                f"real.batch_fraction, normal_labels.batch_fraction: {photographs} and {captures} of "
                f"{self.batch_size} images found, rendered faces are needed too"
            )
        if captures and self.real.encoding != "linear":
            raise InputError(
                "real.encoding: 'srgb' found, 'linear' is needed: photometric stereo's labels are of linear "
                "light"
            )

    def make_model(self) -> Network:
        """The recipe's network as it is before the first step, in training mode; for its seed, the same."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            return self.model.make(self.data.size or FACE_SIZE).train()


def read_recipe(path: Path | str) -> Recipe:
    """Read a recipe.

    Raises:
        InputError: naming the file and the key: unknown, of another type, missing or out of range.
    """
    try:
        recipe = load_toml(Recipe, path)
        recipe.make_model()
    except InputError as error:
        raise InputError(f"{error}" if str(error).startswith(str(path)) else f"{path}: {error}") from error
    return recipe


def with_environments(recipe: Recipe, environments: Path | None) -> Recipe:
    """The recipe with a folder of environment maps in place of its own; as it is for None."""
    if environments is None:
        return recipe
    light = replace(recipe.data.light, environments=str(environments))
    return replace(recipe, data=replace(recipe.data, light=light))


def multiplies_bfloat16(device: torch.device) -> bool:
    """Whether a device has instructions for it; others emulate it."""
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    capabilities = torch.cpu.get_capabilities()
    return any(capabilities.get(name, False) for name in ("avx512_bf16", "amx_bf16"))


def _positive(section: object, *names: str) -> None:
    for name in names:
        if not getattr(section, name) > 0:
            raise InputError(f"{name}: {getattr(section, name)} found, more than 0 is needed")


def _not_negative(section: object, *names: str) -> None:
    for name in names:
        if not getattr(section, name) >= 0:
            raise InputError(f"{name}: {getattr(section, name)} found, 0 or more is needed")
