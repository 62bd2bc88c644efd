"""The processes that train one network together: one alone, or those that torchrun started.

Each has the whole network and a part of every batch. What is summed over the whole batch, the loss, its
gradient and the statistics of batch normalisation, is summed over all processes, so that their number changes
the result by rounding alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

import torch
import torch.distributed as dist
from torch import Tensor, nn

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.models.layers import share_statistics

Device = Literal["auto", "cpu", "cuda"]


@dataclass(frozen=True)
class ProcessGroup:
    """This process among those that train together.

    Attributes:
        rank: its number; 0 writes files and talks.
        size: how many there are.
        device: where it computes.
    """

    rank: int = 0
    size: int = 1
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))

    @property
    def is_main_process(self) -> bool:
        """Whether it writes files and talks."""
        return self.rank == 0

    def sum(self, tensor: Tensor) -> Tensor:
        """The sum of a tensor over all processes, without gradient."""
        if self.size == 1:
            return tensor
        total = tensor.detach().clone()
        dist.all_reduce(total)
        return total

    def sum_gradients(self, model: nn.Module) -> None:
        """Replace every gradient by its sum over all processes, in one message."""
        if self.size == 1:
            return
        gradients = [p.grad for p in model.parameters() if p.grad is not None]
        total = torch.cat([gradient.reshape(-1) for gradient in gradients])
        dist.all_reduce(total)
        begin = 0
        for gradient in gradients:
            end = begin + gradient.numel()
            gradient.copy_(total[begin:end].reshape(gradient.shape))
            begin = end

    def any(self, flag: bool) -> bool:
        """Whether the flag is set in any process."""
        return bool(self.sum(torch.tensor(float(flag), device=self.device)))

    def wait(self) -> None:
        """Wait for all others to come here too."""
        if self.size > 1:
            self.sum(torch.zeros(1, device=self.device))

    def prepare(self, model: nn.Module) -> None:
        """Move a network to the device, its batch normalisation over all processes."""
        model.to(self.device)
        if self.size > 1:
            share_statistics(model)


@contextmanager
def join_process_group(device: Device = "auto") -> Iterator[ProcessGroup]:
    """Join the processes that torchrun started: by gloo on processors, by nccl on GPUs, one GPU a process.

    Without torchrun's variables in the environment this process trains alone.

    Raises:
        InputError: if a GPU is asked for and there is none.
    """
    size, rank = (
        int(os.environ.get(name, default)) for name, default in (("WORLD_SIZE", "1"), ("RANK", "0"))
    )
    if size > 1:
        _see_one_gpu(int(os.environ.get("LOCAL_RANK", rank)))
    chosen = _device(device)
    if size == 1:
        yield ProcessGroup(device=chosen)
        return
    dist.init_process_group("nccl" if chosen.type == "cuda" else "gloo", rank=rank, world_size=size)
    try:
        yield ProcessGroup(rank, size, chosen)
    finally:
        dist.destroy_process_group()


def _see_one_gpu(local: int) -> None:
    """Hide the other processes' GPUs, so that torch's first and Dr.Jit's first are this process's own."""
    visible: Sequence[str] = [v for v in os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",") if v]
    if not visible:
        os.environ["CUDA_VISIBLE_DEVICES"] = str(local)
    elif local < len(visible) and len(visible) > 1:
        os.environ["CUDA_VISIBLE_DEVICES"] = visible[local]


def _device(wanted: Device) -> torch.device:
    there = wanted != "cpu" and torch.cuda.is_available()
    if wanted == "cuda" and not there:
        raise InputError("compute.device: 'cuda' found, but torch sees no GPU; 'cpu' or 'auto' is possible")
    return torch.device("cuda" if there else "cpu")
