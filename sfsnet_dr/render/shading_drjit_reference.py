"""Order-n Lambertian shading in Dr.Jit: the contract of the NumPy and torch forms, orders 0 to 4.

Plain and readable on purpose: the SH polynomials are written out, there is no symbolic loop (its gradients
inside ``dr.wrap`` are wrong), and one kernel serves the whole batch. ``shading_planes`` and ``render_planes``
work on Dr.Jit arrays, for kernels that go on computing with the image, such as the loss.

Source: Sengupta et al., CVPR 2018, eq. 1 and the appendix on spherical harmonics.
"""

from __future__ import annotations

import math
from typing import Any

from torch import Tensor

from sfsnet_dr.core.conventions import NORMAL_EPSILON
from sfsnet_dr.render.drjit_interop import from_planes, from_torch, spread_values, torch_planes
from sfsnet_dr.render.shading_numpy import COLOURS
from sfsnet_dr.render.shading_torch import match, match_shading
from sfsnet_dr.scene.jit import dr
from sfsnet_dr.sh.polynomials import sh_polynomials


def shading(normal: Tensor, light: Tensor) -> Tensor:
    """Shading S = Y(n)^T L of each colour, unclamped.

    Convention: camera frame; basis order of ``sh.basis``; light 9 R, 9 G, 9 B at order 2.

    Args:
        normal: (B, 3, H, W) on the CPU, any length: they are normalised here.
        light: shading coefficients (B, 3K), K = (order + 1)^2, order 0 to 4. A batch of 1 broadcasts.

    Returns:
        (B, 3, H, W), linear; float64 if an argument is, else float32. Differentiable once, backwards, in
        both arguments, with the same bits in every run.

    Raises:
        InputError: naming the argument whose shape does not fit, or a tensor that is not on the CPU.
    """
    return _shading(*match_shading(normal, light))


def f_render(normal: Tensor, albedo: Tensor, light: Tensor) -> Tensor:
    """The paper's f_render: image = albedo * S(normal, light), linear and unclamped.

    Args:
        normal: (B, 3, H, W) on the CPU, any length.
        albedo: (B, 3, H, W), linear.
        light: shading coefficients (B, 3K), order 0 to 4. A batch of 1 broadcasts.

    Returns:
        (B, 3, H, W); float64 if an argument is, else float32. Differentiable once, backwards, in all three
        arguments, with the same bits in every run.

    Raises:
        InputError: naming the argument whose shape does not fit, or a tensor that is not on the CPU.
    """
    return _render(*match(normal, albedo, light))


def shading_planes(normal: list[Any], light: list[Any]) -> list[Any]:
    """Shading of each colour on Dr.Jit arrays.

    Args:
        normal: planes x, y, z, any length.
        light: 3K planes or single values: K of red, K of green, K of blue.

    Returns:
        3 planes: red, green, blue.
    """
    x, y, z = _shortened(*normal)
    inverse_length = 1 / dr.sqrt(dr.maximum(x * x + y * y + z * z, NORMAL_EPSILON))
    order = math.isqrt(len(light) // COLOURS) - 1
    basis = sh_polynomials(x * inverse_length, y * inverse_length, z * inverse_length, order)
    count = len(basis)
    return [_dot(basis, light[c * count : (c + 1) * count]) for c in range(COLOURS)]


def render_planes(normal: list[Any], albedo: list[Any], light: list[Any]) -> list[Any]:
    """f_render on Dr.Jit arrays: 3 planes from 3 planes, 3 planes and 3K planes or single values."""
    return [a * s for a, s in zip(albedo, shading_planes(normal, light), strict=True)]


def _shading_kernel(normal: Any, light: Any) -> Any:
    batch, channels, height, width = normal.shape
    values = shading_planes(torch_planes(normal), spread_values(light, height * width))
    return from_planes(values, (batch, channels, height, width))


def _render_kernel(normal: Any, albedo: Any, light: Any) -> Any:
    batch, channels, height, width = normal.shape
    values = render_planes(torch_planes(normal), torch_planes(albedo), spread_values(light, height * width))
    return from_planes(values, (batch, channels, height, width))


def _shortened(x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
    """Long vectors shortened, the others as they are; see ``shading_torch.unit``."""
    longest = dr.maximum(dr.maximum(dr.abs(x), dr.abs(y)), dr.abs(z))
    factor = 1 / dr.maximum(dr.detach(longest), 1)
    return x * factor, y * factor, z * factor


def _dot(basis: list[Any], coefficients: list[Any]) -> Any:
    total = basis[0] * coefficients[0]
    for value, coefficient in zip(basis[1:], coefficients[1:], strict=True):
        total = dr.fma(value, coefficient, total)
    return total


_shading = from_torch(_shading_kernel)
_render = from_torch(_render_kernel)
