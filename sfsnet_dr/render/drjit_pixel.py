"""f_render of one pixel and its adjoint, on Dr.Jit arrays: what the kernels compute, without the memory.

With n' = n / sqrt(max(|n|^2, e)), shapes P_k(n') and the light l_ck = scale_k L_ck:
image_c = albedo_c S_c, S_c = sum_k l_ck P_k. For upstream gradients g_c the adjoint is
d albedo_c = g_c S_c, d l_ck = g_c albedo_c P_k, and, with q_k = sum_c g_c albedo_c l_ck and
t = sum_k q_k grad P_k, d n = (t - n' <n', t>) / |n|, or t / sqrt(e) for shorter normals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from sfsnet_dr.base.conventions import NORMAL_EPSILON
from sfsnet_dr.render.shading_inputs import COLOURS
from sfsnet_dr.scene.jit import dr
from sfsnet_dr.sh.monomials import CONSTANT, Evaluator, basis_functions

#: |n|^2 above which a normal is shortened before it overflows, and the factor; by precision.
_LONG = ((1e36, 1e-20), (1e300, 1e-155))


def folded(light: Sequence[Any]) -> list[Any]:
    """Light with the scales of the basis in it: 3K numbers, K of red, of green and of blue."""
    return [value * scale for value, scale in zip(light, _scales(len(light)), strict=True)]


class Shaded:
    """One pixel: its unit normal and the basis there, its shading, and the adjoint, colour by colour.

    Dr.Jit computes in the order in which this is traced. Finishing one colour before the next keeps fewer
    numbers alive, and a fifth of the instructions away that would move them to memory and back.
    """

    def __init__(self, normal: Sequence[Any], light: Sequence[Any]) -> None:
        """Normal: x, y, z of any length; light: ``folded``."""
        self._order = math.isqrt(len(light) // COLOURS) - 1
        self._count = len(light) // COLOURS
        self._light = light
        self._normalise(normal)
        self._at = Evaluator(self._unit, dr.fma)
        self._basis = [self._at(f.shape) for f in basis_functions(self._order)]
        self._pull: list[Any] = [0.0] * self._count
        self._multiples: dict[tuple[int, float], Any] = {}

    def shading(self, colour: int) -> Any:
        """S of one colour."""
        light = self._light[colour * self._count :]
        total = light[0]  # the first basis function is constant, its shape is 1
        for k in range(1, self._count):
            total = dr.fma(self._basis[k], light[k], total)
        return total

    def send(self, colour: int, weight: Any, sums: list[Any]) -> None:
        """Carry d loss / d S of one colour on to the light and the normal.

        Args:
            sums: 3K sums over pixels of d loss / d folded light; this pixel's are added.
        """
        first = colour * self._count
        sums[first] = sums[first] + weight
        for k in range(1, self._count):
            sums[first + k] = dr.fma(weight, self._basis[k], sums[first + k])
            self._pull[k] = dr.fma(weight, self._light[first + k], self._pull[k])

    def normal_gradient(self) -> list[Any]:
        """d loss / d normal, of what has been sent."""
        tangent = [self._along(axis) for axis in range(3)]
        x, y, z = self._unit
        radial = dr.fma(tangent[0], x, dr.fma(tangent[1], y, tangent[2] * z))
        radial = dr.select(self._clamped, 0, radial)
        return [dr.fma(-radial, u, t) * self._inverse for u, t in zip(self._unit, tangent, strict=True)]

    def _normalise(self, normal: Sequence[Any]) -> None:
        x, y, z = normal
        longest, factor = _LONG[dr.float64_array_t(type(x)) is type(x)]
        shorten = dr.select(_squared(x, y, z) > longest, factor, 1)
        x, y, z = x * shorten, y * shorten, z * shorten
        squared = _squared(x, y, z)
        # An infinite component makes all three NaN, as in the other forms; else the finite two would be 0.
        inverse = dr.select(squared == dr.inf, dr.nan, dr.rsqrt(dr.maximum(squared, NORMAL_EPSILON)))
        self._clamped = squared < NORMAL_EPSILON
        self._unit = (x * inverse, y * inverse, z * inverse)
        self._inverse = inverse * shorten

    def _along(self, axis: int) -> Any:
        total: Any = 0.0
        for k, function in enumerate(basis_functions(self._order)):
            slope = function.slopes[axis]
            if len(slope.terms) == 1:
                ((powers, coefficient),) = slope.terms
                pull = self._times(k, coefficient)
                total = pull + total if powers == CONSTANT else dr.fma(pull, self._at.monomial(powers), total)
            elif slope.terms:
                total = dr.fma(self._pull[k], self._at(slope), total)
        return total

    def _times(self, k: int, coefficient: float) -> Any:
        """A multiple of one pull; 2 and -2 times it are one product."""
        size = abs(coefficient)
        if (k, size) not in self._multiples:
            self._multiples[k, size] = self._pull[k] if size == 1 else self._pull[k] * size
        product = self._multiples[k, size]
        return product if coefficient > 0 else -product


def unfolded(sums: Sequence[Any]) -> list[Any]:
    """Gradients by the light itself from gradients by the folded one."""
    return [value * scale for value, scale in zip(sums, _scales(len(sums)), strict=True)]


def _scales(count: int) -> list[float]:
    order = math.isqrt(count // COLOURS) - 1
    return [f.scale for f in basis_functions(order)] * COLOURS


def _squared(x: Any, y: Any, z: Any) -> Any:
    return dr.fma(x, x, dr.fma(y, y, z * z))
