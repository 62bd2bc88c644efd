"""The reconstruction loss and all its gradients from one pass over the pixels, by one Dr.Jit kernel.

The forward pass already computes the gradients, because all that they need is in registers then; the
backward pass hands them on, multiplied by what arrives from above. ``reconstruction_drjit_plain`` is the
readable twin. A second, small kernel adds up the mask beforehand: gradients are divided by it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, cast

import torch
from torch import Tensor

from sfsnet_dr.render.drjit_interop import first_order_only
from sfsnet_dr.render.drjit_kernel import Call, Shaded, Signature, freeze_kernel, strip_subclass, unfold_batch
from sfsnet_dr.render.drjit_loop import Lanes, Source, real, sweep
from sfsnet_dr.render.shading_numpy import COLOURS
from sfsnet_dr.scene.jit import dr


def masked_l1_mean(
    normal: Tensor, albedo: Tensor, light: Tensor, image: Tensor, mask: Tensor, expected: float = 1
) -> Tensor:
    """The loss of ``reconstruction_l1``; tensors of one dtype and batch size.

    Args:
        expected: the gradient that is likely to arrive in the backward pass. The stored gradients hold this
            factor already; another one costs a pass over them.
    """
    inputs = [strip_subclass(x) for x in (normal, albedo, light, image, mask)]
    return cast(Tensor, _MaskedL1.apply(*inputs, expected or 1.0))  # type: ignore[no-untyped-call]


class _MaskedL1(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        *tensors, ctx.expected = inputs
        ctx.grads = None
        if not any(ctx.needs_input_grad):
            return _value(*tensors)
        ctx.save_for_backward(*tensors)
        loss, ctx.grads = value_and_gradients(ctx.expected, *tensors)
        return loss

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        first_order_only()
        # Given away, so that torch may keep them without a copy. Who comes again has them computed again.
        grads, ctx.grads = ctx.grads, None
        if grads is None:
            _, grads = value_and_gradients(ctx.expected, *ctx.saved_tensors)
        (found,) = upstream
        if found.device.type != "cpu" or float(found) != ctx.expected:  # on a GPU, asking would mean waiting
            factor = found / ctx.expected
            grads = [g.mul_(factor) for g in grads]
        return (*grads, None, None, None)


def _value(normal: Tensor, albedo: Tensor, light: Tensor, image: Tensor, mask: Tensor) -> Tensor:
    call = Call([normal, albedo, image, mask], light, dense=1)
    (sums,) = call.launch(_value_kernel(call.signature), 1)
    return call.per_image(sums, 1).sum()


def value_and_gradients(
    expected: float,
    normal: Tensor,
    albedo: Tensor,
    light: Tensor,
    image: Tensor,
    mask: Tensor,
    **tuning: int,
) -> tuple[Tensor, list[Tensor]]:
    """The loss, and ``expected`` times its gradients by normal, albedo and light.

    Args:
        tuning: ``packet`` and ``run`` of ``Call``, for experiments.
    """
    call = Call([normal, albedo, image, mask], light, dense=1, **tuning)
    factor = real(call.signature.kinds, expected)
    kernel = _gradient_kernel(call.signature)
    sums = light.shape[1] + 1
    of_normal, of_albedo, rows = call.launch(kernel, sums, factor, normal.numel())
    summed = call.per_image(rows, sums)
    return summed[:, 0].sum(), [call.image(0, of_normal), call.image(1, of_albedo), summed[:, 1:]]


@functools.cache
def _value_kernel(what: Signature) -> Callable[..., Any]:
    @freeze_kernel
    def kernel(lanes: Lanes, sources: list[Source], light: Source) -> list[Any]:
        coefficients, weight = what.load_light(lanes, light), _weight(sources[3])

        def pixel(read: list[list[Any]], sums: list[Any]) -> tuple[list[list[Any]], list[Any]]:
            normal, albedo, image, (mask,) = read
            shaded, total = Shaded(normal, coefficients), sums[0]
            for c in range(COLOURS):
                residual = dr.fma(albedo[c], shaded.shading(c), -image[c])
                total = dr.fma(dr.abs(residual), mask, total)
            return [], [total]

        def finish(sums: list[Any]) -> list[Any]:
            return [sums[0] * weight]

        return [sweep(what.kinds, what.packet, lanes, what.reads(sources), [], 1, pixel, finish)[1]]

    return kernel


@functools.cache
def _gradient_kernel(what: Signature) -> Callable[..., Any]:
    @freeze_kernel
    def kernel(lanes: Lanes, sources: list[Source], light: Source, expected: Any, size: int) -> list[Any]:
        coefficients, weight = what.load_light(lanes, light), _weight(sources[3])

        def pixel(read: list[list[Any]], sums: list[Any]) -> tuple[list[list[Any]], list[Any]]:
            normal, albedo, image, (mask,) = read
            shaded, total, light_sums = Shaded(normal, coefficients), sums[0], sums[1:]
            slope, of_albedo = mask * (weight * expected), []
            for c in range(COLOURS):
                shading = shaded.shading(c)
                residual = dr.fma(albedo[c], shading, -image[c])
                total = dr.fma(dr.abs(residual), mask, total)
                # The slope of |x| at 0 is 0.
                upstream = dr.select(residual > 0, slope, dr.select(residual < 0, -slope, 0))
                of_albedo.append(upstream * shading)
                shaded.send(c, upstream * albedo[c], light_sums)
            return [shaded.normal_gradient(), of_albedo], [total, *light_sums]

        def finish(sums: list[Any]) -> list[Any]:
            return [sums[0] * weight, *unfold_batch(sums[1:])]

        outputs = [(layout, size) for layout in what.layouts[:2]]
        sums = what.light_size + 1
        reads = what.reads(sources)
        arrays, rows = sweep(what.kinds, what.packet, lanes, reads, outputs, sums, pixel, finish)
        return [*arrays, rows]

    return kernel


def _weight(mask: Source) -> Any:
    """1 / max(3 sum mask, 1)."""
    return 1 / dr.maximum(COLOURS * dr.sum(mask.values), 1)
