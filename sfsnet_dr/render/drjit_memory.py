"""Torch tensors as flat Dr.Jit arrays without copies, and how a kernel finds its pixels in them.

Kernels read *packets*: ``PACKET`` neighbouring numbers a lane, which LLVM loads with whole vectors and
transposes in registers. That is several times as fast as one indexed load a number, and it reads images of
separate planes (torch's usual layout) and interleaved ones (channels-last) equally well. A packet must not
straddle two images and must be aligned; what does not fit is read number by number.
"""

from __future__ import annotations

import functools
from typing import Any, Final, NamedTuple

import torch
from torch import Tensor

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.render.shading_inputs import COLOURS, MAX_ELEMENTS
from sfsnet_dr.scene.jit import dr

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


class View(NamedTuple):
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
def types(device: str, dtype: torch.dtype) -> Types:
    """Dr.Jit's types for tensors of a device type and a dtype.

    Raises:
        BadInput: for other devices than the CPU and CUDA, and other dtypes than float32 and float64.
    """
    if device not in ("cpu", "cuda"):
        raise BadInput(
            f"tensor on {device} found, cpu or cuda expected by the Dr.Jit form; use the torch form"
        )
    if dtype not in (torch.float32, torch.float64):
        raise BadInput(f"tensor of {dtype} found, float32 or float64 expected")
    module = dr.llvm if device == "cpu" else dr.cuda
    single = dtype == torch.float32
    value, packet = (module.Float32, module.ArrayXf) if single else (module.Float64, module.ArrayXf64)
    return Types(value, packet, module.UInt32)


def packet_size(pixels: int, largest: int = PACKET) -> int:
    """Numbers in the packets that images of so many pixels divide into: the largest allowed, or 1."""
    return largest if pixels % largest == 0 else 1


def view(tensor: Tensor, packet: int, *, dense: bool = False) -> View:
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


def shaped(layout: Layout, flat: Tensor, shape: tuple[int, ...]) -> Tensor:
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


def _view(tensor: Tensor, packet: int) -> View | None:
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
    return View(flat, layout, image // packet, 0 if layout.interleaved else channel // packet)
