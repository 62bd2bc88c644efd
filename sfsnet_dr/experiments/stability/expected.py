"""What a form should give: value, gradients and the size of their round-off, in float64.

Independent of the forms: values by the evaluation of the basis that a form does not use (the recurrence for
those on polynomials, the polynomials for NumPy's; tests hold both against SciPy), derivatives by a complex
step, chained by hand. Errors are measured against a *scale*, not against the value itself, which
may cancel to nothing: by the addition theorem a band l of light L can give no more than
sqrt((2l + 1) / 4 pi) |L|, and that is what rounding errors are proportional to.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.conventions import NORMAL_EPSILON
from sfsnet_dr.render.shading_numpy import COLOURS
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.kernel import band_of
from sfsnet_dr.sh.polynomials import sh_polynomials

Array = npt.NDArray[np.float64]

_STEP = 1e-30  # of the complex step: no difference is taken, so that it may be this small


class ExpectedResult(NamedTuple):
    """Value and gradients, each with its scale.

    Attributes:
        value: (B, 3, H, W) of a renderer, () of the loss.
        scale: the largest value that these albedos and lights can give, same shape.
        grads: of normal, albedo and light, for a batch that has been expanded.
        grad_scales: the largest value that each entry's terms can add up to.
    """

    value: Array
    scale: Array
    grads: tuple[Array, Array, Array]
    grad_scales: tuple[Array, Array, Array]


def expected_image(
    normal: Array,
    albedo: Array,
    light: Array,
    weights: Array,
    epsilon: float = NORMAL_EPSILON,
    *,
    polynomials: bool = False,
) -> ExpectedResult:
    """f_render and the gradients of its sum weighted by ``weights`` (B, 3, H, W).

    Args:
        normal: (B, 3, H, W), any length.
        albedo: (B, 3, H, W).
        light: (B, 3K), order 0 to 4.
        weights: what arrives from behind in a backward pass.
        epsilon: squared length below which a normal counts as having this length.
        polynomials: evaluate the basis by polynomials instead of by recurrence.
    """
    order = math.isqrt(light.shape[1] // COLOURS) - 1
    coefficients = light.reshape(len(light), COLOURS, (order + 1) ** 2)
    squared = np.sum(normal**2, axis=1, keepdims=True)
    # A normal with an infinite component has no direction at all.
    length = np.sqrt(np.where(np.isinf(squared), np.nan, np.maximum(squared, epsilon)))
    direction = normal / length
    basis = (_polynomial_basis if polynomials else _recurrence_basis)(direction, order)
    shading = np.einsum("bhwk,bck->bchw", basis, coefficients)
    band = band_of(order)
    most = np.sqrt((2 * band + 1) / (4 * math.pi))
    brightest = (np.abs(coefficients) @ most)[:, :, None, None] * np.ones_like(shading)
    steepest = (np.abs(coefficients) @ (most * np.sqrt(2 * band**2 + band)))[:, :, None, None]

    arriving = weights * albedo
    slope = np.einsum("bchw,bck,dbhwk->bdhw", arriving, coefficients, _basis_slopes(direction, order))
    radial = np.where(squared > epsilon, np.sum(slope * direction, axis=1, keepdims=True), 0)
    grads = (
        (slope - direction * radial) / length,
        weights * shading,
        np.einsum("bchw,bhwk->bck", arriving, basis).reshape(light.shape),
    )
    slope_scale = 2 * np.sum(np.abs(arriving) * steepest, axis=1, keepdims=True) / length
    grad_scales = (
        slope_scale * np.ones_like(normal),
        np.abs(weights) * brightest,
        np.einsum("bchw,k->bck", np.abs(arriving), most).reshape(light.shape),
    )
    return ExpectedResult(albedo * shading, np.abs(albedo) * brightest, grads, grad_scales)


def expected_loss(
    normal: Array, albedo: Array, light: Array, image: Array, mask: Array, epsilon: float = NORMAL_EPSILON
) -> ExpectedResult:
    """The reconstruction loss, shapes as ``reconstruction_l1`` after broadcasting."""
    denominator = max(COLOURS * mask.sum(), 1.0)
    rendered = expected_image(normal, albedo, light, np.zeros_like(image), epsilon)
    residual = image - rendered.value
    weights = -np.sign(residual) * mask / denominator
    # Where the residual is 0 its sign may come out either way; the scale counts such pixels fully.
    there = np.broadcast_to(mask / denominator, image.shape)
    found = expected_image(normal, albedo, light, weights, epsilon)
    scales = expected_image(normal, albedo, light, np.asarray(there), epsilon).grad_scales
    value = np.sum(mask * np.abs(residual)) / denominator
    scale = np.sum(mask * (np.abs(image) + rendered.scale)) / denominator
    return ExpectedResult(np.asarray(value), np.asarray(scale), found.grads, scales)


def _polynomial_basis(direction: Array, order: int) -> Array:
    x, y, z = np.moveaxis(direction, 1, 0)
    values = sh_polynomials(x, y, z, order)
    return np.stack([v * np.ones(direction[:, 0].shape) for v in values], axis=-1)


def _recurrence_basis(direction: Array, order: int) -> Array:
    return sh_basis(np.moveaxis(direction, 1, -1), order)


def _basis_slopes(direction: Array, order: int) -> Array:
    """Derivatives (3, B, H, W, K) of the basis polynomials along x, y and z."""
    slopes = []
    for axis in range(3):
        x, y, z = (direction[:, i] + (1j * _STEP if i == axis else 0j) for i in range(3))
        values = [np.imag(v) * np.ones(x.shape) / _STEP for v in sh_polynomials(x, y, z, order)]
        slopes.append(np.stack(values, axis=-1))
    return np.stack(slopes)
