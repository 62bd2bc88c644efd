"""The photometric reconstruction loss, one interface for its Dr.Jit kernel and its twins."""

from __future__ import annotations

from typing import Final, Literal, get_args

from torch import Tensor

from sfsnet_dr.core.errors import InputError, check_shape, nearest
from sfsnet_dr.render.shading_numpy import COLOURS
from sfsnet_dr.render.shading_torch import match

#: ``drjit``: one fast kernel. ``drjit-plain``: its readable twin (CPU). ``torch``: any device and derivative.
Backend = Literal["drjit", "drjit-plain", "torch"]
BACKENDS: Final[tuple[Backend, ...]] = get_args(Backend)


def reconstruction_l1(
    normal: Tensor,
    albedo: Tensor,
    light: Tensor,
    image: Tensor,
    mask: Tensor,
    *,
    backend: Backend = "drjit",
    expected_gradient: float = 1,
) -> Tensor:
    """Masked mean of |image - f_render(normal, albedo, light)| over pixels and colours.

    The paper (appendix, E_recon) sums over the pixels of the face; this divides by their number, so that
    the value does not depend on the size of an image, a face or a batch:
    sum mask |image - f_render| / max(3 sum mask, 1).

    Args:
        normal: (B, 3, H, W), any length: they are normalised here. Batches of 1 broadcast here, in
            albedo and in light.
        albedo: (B, 3, H, W), linear.
        light: shading coefficients (B, 3K), order 0 to 4.
        image: (B, 3, H, W), linear. A constant: it gets no gradient.
        mask: (B, 1, H, W), weights from 0 to 1. A constant: it gets no gradient.
        backend: one of ``BACKENDS``; the Dr.Jit ones have first derivatives only.
        expected_gradient: what the caller will multiply the loss by. ``"drjit"`` computes gradients in the
            forward pass and saves a pass over them if this is right; results do not depend on it.

    Returns:
        Scalar tensor; float64 if normal, albedo or light is, else float32. It is 0 for an empty mask. The
        gradient of |x| at 0 is 0. NaN anywhere, masked out or not, gives NaN.

    Raises:
        InputError: naming the argument whose shape does not fit, or an unknown backend.
    """
    normal, albedo, light = match(normal, albedo, light)
    sizes = {"B": normal.shape[0], "H": normal.shape[2], "W": normal.shape[3]}
    check_shape("image", image, "B 3 H W", **sizes)
    check_shape("mask", mask, "B 1 H W", **sizes)
    image, mask = image.detach().to(normal.dtype), mask.detach().to(normal.dtype)
    if backend == "drjit":
        from sfsnet_dr.losses.reconstruction_drjit import masked_l1_mean

        return masked_l1_mean(normal, albedo, light, image, mask, expected_gradient)
    if backend == "drjit-plain":
        from sfsnet_dr.losses.reconstruction_drjit_reference import masked_l1_sum
    elif backend == "torch":
        from sfsnet_dr.losses.reconstruction_torch import masked_l1_sum
    else:
        raise InputError(f"backend: {backend!r} found; {nearest(str(backend), BACKENDS)}")
    return masked_l1_sum(normal, albedo, light, image, mask) / (COLOURS * mask.sum()).clamp_min(1)
