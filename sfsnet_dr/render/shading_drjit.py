"""Order-n Lambertian shading by one Dr.Jit kernel a call: the contract of the NumPy and torch forms.

The fast form; ``shading_drjit_plain`` is its readable twin and says the same with ``dr.wrap``. Values and
gradients are separate kernels (``drjit_pixel``) over all pixels of a batch (``drjit_lanes``), recorded once
and then replayed by ``@dr.freeze``. Tensors are read where they lie, plane by plane or channels-last.

Source: Sengupta et al., CVPR 2018, eq. 1 and the appendix on spherical harmonics.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, cast

import torch
from torch import Tensor

from sfsnet_dr.render.drjit_interop import first_order_only
from sfsnet_dr.render.drjit_kernel import Call, Shaded, Signature, freeze_kernel, strip_subclass, unfold_batch
from sfsnet_dr.render.drjit_loop import Lanes, Source, sweep
from sfsnet_dr.render.shading_numpy import COLOURS
from sfsnet_dr.render.shading_torch import match, match_shading


def shading(normal: Tensor, light: Tensor) -> Tensor:
    """Shading S = Y(n)^T L of each colour, unclamped.

    Convention: camera frame; basis order of ``sh.basis``; light 9 R, 9 G, 9 B at order 2.

    Args:
        normal: (B, 3, H, W) on the CPU or a CUDA device, any length: they are normalised here.
        light: shading coefficients (B, 3K), K = (order + 1)^2, order 0 to 4. A batch of 1 broadcasts.

    Returns:
        (B, 3, H, W), linear, in the memory layout of ``normal``; float64 if an argument is, else float32.
        Differentiable once, backwards, in both arguments, with the same bits in every run.

    Raises:
        InputError: naming the argument whose shape does not fit, or a tensor on another device.
    """
    normal, light = match_shading(normal, light)
    return cast(Tensor, _Render.apply(strip_subclass(normal), None, strip_subclass(light)))  # type: ignore[no-untyped-call]


def f_render(normal: Tensor, albedo: Tensor, light: Tensor) -> Tensor:
    """The paper's f_render: image = albedo * S(normal, light), linear and unclamped.

    Args:
        normal: (B, 3, H, W) on the CPU or a CUDA device, any length.
        albedo: (B, 3, H, W), linear.
        light: shading coefficients (B, 3K), order 0 to 4. A batch of 1 broadcasts.

    Returns:
        (B, 3, H, W), in the memory layout of ``normal``; float64 if an argument is, else float32.
        Differentiable once, backwards, in all three arguments, with the same bits in every run.

    Raises:
        InputError: naming the argument whose shape does not fit, or a tensor on another device.
    """
    inputs = [strip_subclass(x) for x in match(normal, albedo, light)]
    return cast(Tensor, _Render.apply(*inputs))  # type: ignore[no-untyped-call]


class _Render(torch.autograd.Function):
    """f_render, or the shading alone where there is no albedo."""

    @staticmethod
    def forward(ctx: Any, normal: Tensor, albedo: Tensor | None, light: Tensor) -> Tensor:
        ctx.save_for_backward(normal, albedo, light)
        call = Call([normal] if albedo is None else [normal, albedo], light)
        (array,) = call.launch(_forward(call.signature), 0, normal.numel())
        return call.image(0, array)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        first_order_only()
        normal, albedo, light = ctx.saved_tensors
        images = [normal] if albedo is None else [normal, albedo]
        call = Call([*images, strip_subclass(upstream[0])], light)
        *arrays, sums = call.launch(_backward(call.signature), light.shape[1], normal.numel())
        grads = [call.image(k, array) for k, array in enumerate(arrays)]
        return grads[0], (None if albedo is None else grads[1]), call.per_image(sums, light.shape[1])


@functools.cache
def _forward(what: Signature) -> Callable[..., Any]:
    @freeze_kernel
    def kernel(lanes: Lanes, sources: list[Source], light: Source, size: int) -> list[Any]:
        coefficients = what.load_light(lanes, light)

        def pixel(read: list[list[Any]], sums: list[Any]) -> tuple[list[list[Any]], list[Any]]:
            shaded = Shaded(read[0], coefficients)
            values = [shaded.shading(c) for c in range(COLOURS)]
            if len(read) == 2:
                values = [a * s for a, s in zip(read[1], values, strict=True)]
            return [values], sums

        return sweep(
            what.kinds, what.packet, lanes, what.reads(sources), [(what.layouts[0], size)], 0, pixel
        )[0]

    return kernel


@functools.cache
def _backward(what: Signature) -> Callable[..., Any]:
    @freeze_kernel
    def kernel(lanes: Lanes, sources: list[Source], light: Source, size: int) -> list[Any]:
        coefficients = what.load_light(lanes, light)

        def pixel(read: list[list[Any]], sums: list[Any]) -> tuple[list[list[Any]], list[Any]]:
            shaded, upstream, sums = Shaded(read[0], coefficients), read[-1], list(sums)
            of_albedo = []
            for c in range(COLOURS):
                if len(read) == 3:
                    of_albedo.append(upstream[c] * shaded.shading(c))
                    shaded.send(c, upstream[c] * read[1][c], sums)
                else:
                    shaded.send(c, upstream[c], sums)
            return [shaded.normal_gradient(), of_albedo], sums

        outputs = [(layout, size) for layout in what.layouts[:-1]]
        reads = what.reads(sources)
        arrays, sums = sweep(
            what.kinds, what.packet, lanes, reads, outputs, what.light_size, pixel, unfold_batch
        )
        return [*arrays, sums]

    return kernel
