"""Other ways to compute the reconstruction loss and its gradients with Dr.Jit, kept to be measured.

``sfsnet-dr bench loss`` times them beside the one that is used, so that the choice can be checked on another
machine. None of them is meant for training.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any, Final, NamedTuple

import torch
from torch import Tensor

from sfsnet_dr.experiments.benchmarks.agreement import Result, require_agreement
from sfsnet_dr.losses.reconstruction_drjit import value_and_gradients
from sfsnet_dr.losses.reconstruction_drjit_reference import masked_l1_sum
from sfsnet_dr.render.drjit_kernel import Call, Shaded, Signature, freeze_kernel
from sfsnet_dr.render.drjit_loop import Lanes, Source, sweep
from sfsnet_dr.render.shading_numpy import COLOURS
from sfsnet_dr.render.shading_torch import unit
from sfsnet_dr.scene.jit import dr
from sfsnet_dr.sh.basis_torch import sh_basis

#: An upstream gradient that the kernel did not expect.
_UPSTREAM: Final = 0.3

Loss = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], Any]


def _as_result(output: Any, mask: Tensor) -> Result:
    loss, gradients = output
    return Result(loss, *gradients)


class Variant(NamedTuple):
    """One way to compute the loss and its gradients.

    Attributes:
        text: what it does, for the table.
        compute: takes inputs as ``reconstruction_l1`` does.
        setting: of Dr.Jit while it runs.
        channels_last: the memory format of its inputs.
        result: value and gradients of the mean loss from what ``compute`` gave and the mask, to be held to
            the reference before it is timed.
    """

    text: str
    compute: Loss
    setting: Callable[[], AbstractContextManager[Any]] = nullcontext
    channels_last: bool = False
    result: Callable[[Any, Tensor], Result] = _as_result


def check_variant(name: str, variant: Variant, inputs: tuple[Tensor, ...], expected: Result) -> None:
    """Hold a variant to the reference on some inputs.

    Raises:
        RunError: if its value or a gradient differs; see ``require_agreement``.
    """
    found = variant.result(make_call(variant, inputs)(), inputs[-1])
    require_agreement(f"bench loss: variant {name!r}", found, [part for part in expected if part is not None])


def make_call(variant: Variant, inputs: tuple[Tensor, ...]) -> Callable[[], Any]:
    """The variant on some inputs (normal, albedo, light, image, mask), to be called repeatedly."""
    if variant.channels_last:
        inputs = tuple(t.contiguous(memory_format=torch.channels_last) if t.ndim == 4 else t for t in inputs)

    def call() -> Any:
        with variant.setting():
            return variant.compute(*inputs)

    return call


def with_matrix_product(
    normal: Tensor, albedo: Tensor, light: Tensor, image: Tensor, mask: Tensor
) -> tuple[Tensor, list[Tensor]]:
    """The kernel writes the gradient by the shading; torch multiplies it with the basis for the light's."""
    loss, of_normal, of_albedo, weights = _with_weights(normal, albedo, light, image, mask)
    basis = sh_basis(unit(normal), 2, dim=1).flatten(2)
    of_light = torch.bmm(weights.flatten(2), basis.transpose(1, 2)).flatten(1)
    return loss, [of_normal, of_albedo, of_light]


def _with_weights(*inputs: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    normal, albedo, light, image, mask = inputs
    call = Call([normal, albedo, image, mask], light, dense=1)
    *arrays, rows = call.launch(_weight_kernel(call.signature), 1, normal.numel())
    images = [call.image(k % 2, array) for k, array in enumerate(arrays)]
    count = (COLOURS * mask.sum()).clamp_min(1)
    for gradient in images:
        gradient /= count
    return call.per_image(rows, 1).sum() / count, *images  # type: ignore[return-value]


@functools.cache
def _weight_kernel(what: Signature) -> Callable[..., Any]:
    @freeze_kernel
    def kernel(lanes: Lanes, sources: list[Source], light: Source, size: int) -> list[Any]:
        coefficients = what.load_light(lanes, light)

        def pixel(read: list[list[Any]], sums: list[Any]) -> tuple[list[list[Any]], list[Any]]:
            normal, albedo, image, (mask,) = read
            shaded, total = Shaded(normal, coefficients), sums[0]
            of_albedo, weights = [], []
            for c in range(COLOURS):
                shading = shaded.shading(c)
                residual = dr.fma(albedo[c], shading, -image[c])
                total = dr.fma(dr.abs(residual), mask, total)
                upstream = dr.select(residual > 0, mask, dr.select(residual < 0, -mask, 0))
                of_albedo.append(upstream * shading)
                weights.append(upstream * albedo[c])
                shaded.send(c, weights[c], [dr.zeros(what.kinds.value)] * what.light_size)
            return [shaded.normal_gradient(), of_albedo, weights], [total]

        outputs = [(what.layouts[k], size) for k in (0, 1, 0)]
        arrays, rows = sweep(what.kinds, what.packet, lanes, what.reads(sources), outputs, 1, pixel)
        return [*arrays, rows]

    return kernel


def _image_by_image(*inputs: Tensor) -> list[Any]:
    batch = inputs[0].shape[0]
    return [value_and_gradients(1, *(t[b : b + 1] for t in inputs)) for b in range(batch)]


def _without_light(output: Any, mask: Tensor) -> Result:
    loss, of_normal, of_albedo, _ = output
    return Result(loss, of_normal, of_albedo, None)


def _of_images(output: Any, mask: Tensor) -> Result:
    """Each image's loss is the mean over its own mask; the batch's is over all of them."""
    counts = COLOURS * mask.sum((1, 2, 3))
    shares = counts.clamp_min(1) / counts.sum().clamp_min(1)
    loss = sum(share * loss for share, (loss, _) in zip(shares, output, strict=True))
    parts = zip(*(gradients for _, gradients in output), strict=True)
    whole = (torch.cat([s * g for s, g in zip(shares, part, strict=True)]) for part in parts)
    return Result(loss, *whole)


def _before_rescaling(output: Any, mask: Tensor) -> Result:
    loss, gradients = output
    return Result(loss, *(g / _UPSTREAM for g in gradients))


def _of_sum(output: Any, mask: Tensor) -> Result:
    count = (COLOURS * mask.sum()).clamp_min(1)
    return Result(None, *(g / count for g in output))


def _wrapped(normal: Tensor, albedo: Tensor, light: Tensor, image: Tensor, mask: Tensor) -> Any:
    leaves = [t.detach().requires_grad_() for t in (normal, albedo, light)]
    return torch.autograd.grad(masked_l1_sum(*leaves, image, mask), leaves)


def _rescaled(*inputs: Tensor) -> Any:
    loss, gradients = value_and_gradients(1, *inputs)
    return loss, [g.mul_(_UPSTREAM) for g in gradients]


def _tuned(**tuning: int) -> Loss:
    def compute(normal: Tensor, albedo: Tensor, light: Tensor, image: Tensor, mask: Tensor) -> Any:
        return value_and_gradients(1, normal, albedo, light, image, mask, **tuning)

    return compute


@contextmanager
def _one_thread() -> Iterator[None]:
    before = dr.thread_count()
    dr.set_thread_count(1)
    try:
        yield
    finally:
        dr.set_thread_count(before)


def _flag_off(flag: str) -> Callable[[], AbstractContextManager[Any]]:
    return lambda: dr.scoped_set_flag(getattr(dr.JitFlag, flag), False)


#: By name. The first is the one that is used.
VARIANTS: Final[dict[str, Variant]] = {
    "used": Variant("packets of 8, runs of 32, replayed", _tuned()),
    "channels_last": Variant("the same, from channels-last memory", _tuned(), channels_last=True),
    "packet_4": Variant("packets of 4 numbers a lane", _tuned(packet=4)),
    "packet_2": Variant("packets of 2", _tuned(packet=2)),
    "packet_1": Variant("single indexed loads and stores", _tuned(packet=1)),
    "run_1": Variant("no run: each lane handles one packet and writes 28 sums", _tuned(run=1)),
    "run_8": Variant("runs of 8 packets", _tuned(run=8)),
    "run_128": Variant("runs of 128 packets, one group an image", _tuned(run=128)),
    "matrix_product": Variant("27 sums by a matrix product in torch", with_matrix_product),
    "no_light_sums": Variant(
        "without the light's gradient (incomplete)", _with_weights, result=_without_light
    ),
    "rescaled": Variant(
        "another upstream gradient than expected: one more pass", _rescaled, result=_before_rescaling
    ),
    "image_by_image": Variant("one launch an image", _image_by_image, result=_of_images),
    "traced": Variant("traced again in every call, without dr.freeze", _tuned(), _flag_off("KernelFreezing")),
    "no_fast_math": Variant("FastMath off", _tuned(), _flag_off("FastMath")),
    "one_thread": Variant("one thread", _tuned(), _one_thread),
    "wrapped": Variant("the plain twin: dr.wrap, block sums for the light", _wrapped, result=_of_sum),
}
