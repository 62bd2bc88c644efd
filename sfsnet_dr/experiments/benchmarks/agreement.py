"""Nothing is timed before it was held to a reference in double precision: its value and its gradients."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import torch
from torch import Tensor

from sfsnet_dr.core.errors import RunError

#: Largest RMS difference over the RMS of the reference. Single precision differs by 1e-6; the sign of one
#: residual near 0 that rounds to the other side among the 3 x 16 x 8 x 8 of the smallest example changes
#: the gradient by 2 / sqrt(3072) = 0.036. At the sizes that are timed, 1e-3.
TOLERANCE: Final = 0.04

#: What the tensors are, in order.
NAMES: Final = ("value", "gradient of normals", "gradient of albedo", "gradient of light")


class Result(NamedTuple):
    """Value and gradients of one contender; None for what it does not compute."""

    value: Tensor | None
    normal: Tensor | None
    albedo: Tensor | None
    light: Tensor | None


def require_agreement(contender: str, found: Sequence[Tensor | None], expected: Sequence[Tensor]) -> None:
    """Hold value and gradients to the reference.

    Args:
        contender: its name, for the message.
        found: value, and gradients of normals, albedo and light, as in ``NAMES``; None is not compared.
        expected: the reference's, all of them.

    Raises:
        RunError: naming the contender, the tensor, and how far off it is.
    """
    for name, ours, reference in zip(NAMES, found, expected, strict=True):
        if ours is None:
            continue
        error = relative_difference(ours, reference)
        if not error <= TOLERANCE:
            raise RunError(
                f"{contender}: {name} differs from the reference by {error:.3g} (relative RMS), at most "
                f"{TOLERANCE:g} is allowed; it was not timed"
            )


def relative_difference(found: Tensor, expected: Tensor) -> float:
    """Return the RMS difference of two tensors of one shape over the RMS of the second; inf for NaN."""
    if found.shape != expected.shape:
        return float("inf")
    difference = (found.double() - expected.double()).square().mean().sqrt()
    error = float(difference / expected.double().square().mean().sqrt().clamp_min(1e-300))
    return error if error == error else float("inf")


def value_and_gradients(value: Tensor, leaves: Sequence[Tensor], upstream: Tensor | None = None) -> Result:
    """Return a value and its gradients by autograd."""
    normal, albedo, light = torch.autograd.grad(value, leaves, upstream)
    return Result(value.detach(), normal, albedo, light)
