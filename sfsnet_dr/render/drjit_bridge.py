"""From a function on Dr.Jit tensors to a safe torch function.

``dr.wrap`` carries values and first-order gradients between torch and Dr.Jit. Left to itself it

* rejects ``nn.Parameter`` and other subclasses, because it asks for the exact type ``torch.Tensor``;
* shares memory with its inputs unseen by torch, so that a tensor changed in place between the forward and
  the backward pass gives a wrong gradient without a word;
* keeps the shape of its result in a global variable, so that two threads that call it at once fail;
* waits for ever in a process that was forked after Dr.Jit had started;
* answers ``create_graph=True`` with gradients that carry no graph, so that a second derivative silently
  counts as zero.

``from_torch`` closes these gaps. Forward-mode derivatives are not offered.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, cast

import torch
from torch import Tensor

from sfsnet_dr.base import runtime
from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.scene.jit import dr

#: Held while ``dr.wrap`` runs forwards, see above. Backward passes need no lock.
_LOCK = threading.Lock()


class _FirstOrder(torch.autograd.Function):
    """The identity on a wrapped result; its backward pass refuses what ``dr.wrap`` would get wrong."""

    @staticmethod
    def forward(ctx: Any, result: Tensor, *inputs: Tensor) -> Tensor:
        # Saved for torch's check of in-place changes only; Dr.Jit keeps its own view of the same memory.
        ctx.save_for_backward(*inputs)
        return result.view_as(result)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        runtime.check_process()
        first_order_only()
        inputs = ctx.saved_tensors
        return (grads[0].contiguous(), *(None for _ in inputs))


def first_order_only() -> None:
    """Called in a backward pass: refuse to be part of a graph for second derivatives.

    Raises:
        RuntimeError: if torch is recording one.
    """
    if torch.is_grad_enabled():
        raise RuntimeError(
            "the Dr.Jit renderer has first-order derivatives only, create_graph=True was asked of it; "
            "use the torch form for second derivatives"
        )


def from_torch(kernel: Callable[..., Any]) -> Callable[..., Tensor]:
    """Make a function of Dr.Jit tensors callable with torch tensors, differentiable once, backwards.

    Args:
        kernel: takes Dr.Jit tensors, returns one Dr.Jit tensor. It must not contain symbolic loops.

    Returns:
        The same function on torch CPU tensors of one dtype, float32 or float64. It may be called, and
        differentiated, from any thread. Only inputs that require gradients get them.

        Raises BadInput for a tensor that is not on the CPU or in a forked process, and RuntimeError in the
        backward pass if second derivatives are asked for or an input was changed in place.
    """
    wrapped = dr.wrap(source="torch", target="drjit")(kernel)

    def call(*inputs: Tensor) -> Tensor:
        runtime.check_process()
        plain = [_plain(x) for x in inputs]
        with _LOCK:
            output = wrapped(*plain)
        result = _FirstOrder.apply(output, *(x.detach() for x in plain))  # type: ignore[no-untyped-call]
        return cast(Tensor, result)

    return call


def _plain(x: Tensor) -> Tensor:
    if x.device.type != "cpu":
        raise BadInput(f"tensor on {x.device} found, cpu expected by the Dr.Jit form; use the torch form")
    return x.as_subclass(Tensor).contiguous()


def kernel_milliseconds(call: Callable[[], Any]) -> float:
    """Time that Dr.Jit's kernels took within one call, without tracing and launching."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        call()
        history = dr.kernel_history()
    kinds = (dr.KernelType.JIT, dr.KernelType.BlockReduce)
    return float(sum(entry["execution_time"] for entry in history if entry["type"] in kinds))


def kernels_compiled(call: Callable[[], Any]) -> int:
    """Kernels that had to be compiled within a call, or loaded from disk."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        call()
        history = dr.kernel_history((dr.KernelType.JIT,))
    return sum(not entry.get("cache_hit", True) or bool(entry.get("cache_disk")) for entry in history)
