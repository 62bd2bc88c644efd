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

Between torch's (B, C, H, W) memory and one Dr.Jit array over all pixels of a batch.

Every kernel runs once over B * H * W pixels. A *plane* is a flat array with one entry a pixel, image after
image. Planes of one channel are contiguous only within an image, hence the gathers and scatters here.

Torch tensors as flat Dr.Jit arrays without copies, and how a kernel finds its pixels in them.

Kernels read *packets*: ``PACKET`` neighbouring numbers a lane, which LLVM loads with whole vectors and
transposes in registers. That is several times as fast as one indexed load a number, and it reads images of
separate planes (torch's usual layout) and interleaved ones (channels-last) equally well. A packet must not
straddle two images and must be aligned; what does not fit is read number by number.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Any, Final, NamedTuple, cast

import torch
from torch import Tensor

from sfsnet_dr.core import runtime
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.render.shading_numpy import COLOURS, MAX_ELEMENTS
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

        Raises InputError for a tensor that is not on the CPU or in a forked process, and RuntimeError in the
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
        raise InputError(f"tensor on {x.device} found, cpu expected by the Dr.Jit form; use the torch form")
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


def torch_planes(tensor: Any) -> list[Any]:
    """Split a Dr.Jit tensor (B, C, H, W) into C planes of B * H * W entries.

    Convention: entry b * H * W + i * W + j of a plane is pixel (i, j) of image b.
    """
    array = tensor.array
    batch, channels, height, width = tensor.shape
    first, step = _addresses(type(array), batch, channels, height * width)
    # No address occurs twice, so the gradient may be written plainly rather than added up.
    mode = dr.ReduceMode.Permute
    return [dr.gather(type(array), array, first + c * step, mode=mode) for c in range(channels)]


def from_planes(values: list[Any], shape: tuple[int, int, int, int]) -> Any:
    """The inverse of ``torch_planes``: a Dr.Jit tensor of ``shape`` (B, C, H, W) from C planes."""
    batch, channels, height, width = shape
    kind = type(values[0])
    first, step = _addresses(kind, batch, channels, height * width)
    array = dr.zeros(kind, batch * channels * height * width)
    for c, value in enumerate(values):
        dr.scatter(array, value, first + c * step, mode=dr.ReduceMode.Permute)
    tensor: Any = dr.tensor_t(kind)
    return tensor(array, shape)


def spread_values(tensor: Any, pixels: int) -> list[Any]:
    """Split a Dr.Jit tensor (B, N) into N planes that are constant over each image of ``pixels`` pixels."""
    return list(dr.custom(_Spread, tensor.array, int(tensor.shape[1]), pixels))


def _addresses(kind: type[Any], batch: int, channels: int, pixels: int) -> tuple[Any, int]:
    """Where channel 0 of every pixel lies in (B, C, H, W) memory, and the distance to the next channel."""
    index = dr.arange(dr.uint32_array_t(kind), batch * pixels)
    return index + (index // pixels) * ((channels - 1) * pixels), pixels


class _Spread(dr.CustomOp):
    """Repeat per-image numbers over the pixels; backwards, add up the pixels of each image.

    A plain gather has the same derivative, but sums it with atomic additions, whose order and hence whose
    last bits depend on the threads: training could not be resumed bit for bit. Block sums have one order.
    """

    def eval(self, source: Any, count: int, pixels: int) -> list[Any]:
        self.kind, self.count, self.pixels = type(source), count, pixels
        self.batch = len(source) // count
        image = dr.arange(dr.uint32_array_t(self.kind), self.batch * pixels) // pixels
        return [dr.gather(self.kind, source, image * count + k) for k in range(count)]

    def forward(self) -> None:
        raise NotImplementedError("the Dr.Jit renderer has reverse-mode derivatives only")

    def backward(self) -> None:
        grads: Any = self.grad_out()
        dr.eval(grads)  # all at once: else every block sum would run the whole kernel again
        array = dr.zeros(self.kind, self.batch * self.count)
        image = dr.arange(dr.uint32_array_t(self.kind), self.batch)
        for k, grad in enumerate(grads):
            dr.scatter(array, dr.block_sum(grad, self.pixels), image * self.count + k)
        self.set_grad_in("source", array)

    def name(self) -> str:
        return "spread"


#: Most numbers that one lane loads at once; Dr.Jit's LLVM backend transposes no more.
PACKET: Final = 8

#: Bytes to which memory is aligned for packets of 8 double-precision numbers, and torch's own alignment.
ALIGNMENT: Final = 64


class Types(NamedTuple):
    """Dr.Jit's types for one device and one torch dtype."""

    value: Any
    packet: Any
    index: Any


class Layout(NamedTuple):
    """How the channels of a pixel lie: beside each other, or in planes. A kernel is compiled for it."""

    channels: int
    interleaved: bool


class MemoryLayout(NamedTuple):
    """The memory of a (B, C, H, W) tensor.

    Attributes:
        values: flat tensor over everything that the tensor spans, sharing its memory.
        layout: what a kernel has to be compiled for.
        image_step: packets from one image to the next; 0 repeats one image.
        channel_step: packets from one plane to the next, where there are planes.
    """

    values: Tensor
    layout: Layout
    image_step: int
    channel_step: int


@functools.cache
def types_of(device: str, dtype: torch.dtype) -> Types:
    """Dr.Jit's types for tensors of a device type and a dtype.

    Raises:
        InputError: for other devices than the CPU and CUDA, and other dtypes than float32 and float64.
    """
    if device not in ("cpu", "cuda"):
        raise InputError(
            f"tensor on {device} found, cpu or cuda expected by the Dr.Jit form; use the torch form"
        )
    if dtype not in (torch.float32, torch.float64):
        raise InputError(f"tensor of {dtype} found, float32 or float64 expected")
    module = dr.llvm if device == "cpu" else dr.cuda
    single = dtype == torch.float32
    value, packet = (module.Float32, module.ArrayXf) if single else (module.Float64, module.ArrayXf64)
    return Types(value, packet, module.UInt32)


def packet_size(pixels: int, largest: int = PACKET) -> int:
    """Numbers in the packets that images of so many pixels divide into: the largest allowed, or 1."""
    return largest if pixels % largest == 0 else 1


def make_view(tensor: Tensor, packet: int, *, dense: bool = False) -> MemoryLayout:
    """Look at a tensor (B, C, H, W) as packets, copying it only if they do not fit its memory.

    Args:
        tensor: of any strides.
        packet: numbers in a packet, a divisor of H W.
        dense: whether images must follow each other without gaps or repetitions.
    """
    found = _view(tensor, packet)
    batch, channels, height, width = tensor.shape
    if found is None or (dense and batch > 1 and found.image_step * packet != channels * height * width):
        found = _view(tensor.clone(memory_format=torch.contiguous_format), packet)
    assert found is not None
    return found


def reshape_output(layout: Layout, flat: Tensor, shape: tuple[int, ...]) -> Tensor:
    """A dense flat tensor as (B, C, H, W) with its channels laid out so."""
    batch, channels, height, width = shape
    if layout.interleaved:
        return flat.view(batch, height, width, channels).permute(0, 3, 1, 2)
    return flat.view(shape)


def to_drjit(flat: Tensor, kind: Any) -> Any:
    """A Dr.Jit array that shares a flat tensor's memory and keeps it alive."""
    # Through NumPy where possible: it takes half the time of DLPack.
    return kind(flat.detach().numpy() if flat.device.type == "cpu" else flat.detach())


def to_torch(array: Any) -> Tensor:
    """A flat tensor that shares an evaluated Dr.Jit array's memory and keeps it alive."""
    tensor: Tensor = torch.utils.dlpack.from_dlpack(array)
    return tensor


def _view(tensor: Tensor, packet: int) -> MemoryLayout | None:
    batch, channels, height, width = tensor.shape
    pixels = height * width
    image, channel, row, column = tensor.stride()
    image, channel = (image if batch > 1 else 0), (channel if channels > 1 else 0)
    rows_join = height == 1 or row == width * (column if width > 1 else row)
    step = column if width > 1 else row if height > 1 else 1
    if step == 1 and rows_join and not (image % packet or channel % packet):
        layout, inside = Layout(channels, False), (channels - 1) * channel + pixels
    elif channels == COLOURS and channel == 1 and step == COLOURS and rows_join and image % packet == 0:
        layout, inside = Layout(channels, True), channels * pixels
    else:
        return None
    span = (batch - 1) * image + inside
    if tensor.data_ptr() % ALIGNMENT or span > MAX_ELEMENTS:
        return None
    flat = tensor.as_strided((span,), (1,))
    return MemoryLayout(flat, layout, image // packet, 0 if layout.interleaved else channel // packet)
