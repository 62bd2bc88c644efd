"""Between torch's (B, C, H, W) memory and one Dr.Jit array over all pixels of a batch.

Every kernel runs once over B * H * W pixels. A *plane* is a flat array with one entry a pixel, image after
image. Planes of one channel are contiguous only within an image, hence the gathers and scatters here.
"""

from __future__ import annotations

from typing import Any

from sfsnet_dr.scene.jit import dr


def planes(tensor: Any) -> list[Any]:
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
    """The inverse of ``planes``: a Dr.Jit tensor of ``shape`` (B, C, H, W) from C planes."""
    batch, channels, height, width = shape
    kind = type(values[0])
    first, step = _addresses(kind, batch, channels, height * width)
    array = dr.zeros(kind, batch * channels * height * width)
    for c, value in enumerate(values):
        dr.scatter(array, value, first + c * step, mode=dr.ReduceMode.Permute)
    tensor: Any = dr.tensor_t(kind)
    return tensor(array, shape)


def spread(tensor: Any, pixels: int) -> list[Any]:
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
