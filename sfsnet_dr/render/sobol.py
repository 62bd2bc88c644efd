"""Sample points for the transport: four numbers in [0, 1) for each pixel and step.

The first two choose the point of the pixel, the last two the direction at the surface. Every sampler shifts
or scrambles its points at random for each pixel, so that estimates are unbiased and the noise of different
pixels is independent; all of it follows from the seed and the pixel's number.
"""

from __future__ import annotations

import math
from typing import Final, Literal, get_args

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.jit import dr, mi

#: ``sobol``: Owen-scrambled Sobol' points (Burley 2020), ``r4``: the additive recurrence of Roberts (2018),
#: ``stratified``: jittered grids of pixel and direction, paired at random, ``independent``: random numbers.
Sampler = Literal["sobol", "r4", "stratified", "independent"]
SAMPLERS: Final[tuple[Sampler, ...]] = get_args(Sampler)

#: The recurrence in four dimensions: powers of 1 / phi_4 with phi^5 = phi + 1.
_PHI = 1.1673039782614187
_STEPS = tuple(_PHI ** -(k + 1) for k in range(4))

#: Bits of a Sobol' point's number: at most 65536 samples.
_BITS = 16

_BELOW_ONE = 1.0 - 2.0**-24


def _direction_numbers(degree: int, coefficients: int, first: tuple[int, ...]) -> list[int]:
    """Sobol' direction numbers v_1 .. of one dimension, as 32-bit fractions."""
    m = list(first)
    for k in range(degree, _BITS):
        value = m[k - degree] ^ (m[k - degree] << degree)
        for j in range(1, degree):
            if (coefficients >> (degree - 1 - j)) & 1:
                value ^= m[k - j] << j
        m.append(value)
    return [value << (31 - k) for k, value in enumerate(m)]


#: Third and fourth dimension, from Joe and Kuo (2008): a polynomial's degree and coefficients, first numbers.
_SOBOL = (_direction_numbers(2, 1, (1, 3)), _direction_numbers(3, 1, (1, 3, 1)))

#: Bits of a number to which those are added that lie 1, 2, 4 and 8 places above.
_ABOVE = {1: 0x5555, 2: 0x3333, 4: 0x0F0F, 8: 0x00FF}


def check_samples(name: str, samples: int) -> None:
    """Refuse a number of samples that has no place in a set of points.

    Raises:
        InputError: naming the count and what is allowed.
    """
    if not 1 <= samples <= 1 << _BITS:
        raise InputError(f"{name}: {samples} found, 1 to {1 << _BITS} allowed")


class Points:
    """Points of each pixel.

    Args:
        sampler: one of ``SAMPLERS``.
        pixel: numbers of the pixels, one a lane.
        seed: opaque; another seed gives an independent set.

    Raises:
        InputError: for an unknown sampler.
    """

    def __init__(self, sampler: str, pixel: mi.UInt32, seed: mi.UInt32) -> None:
        samplers = {
            "sobol": _sobol,
            "r4": _recurrence,
            "stratified": _stratified,
            "independent": _independent,
        }
        if sampler not in samplers:
            raise InputError(f"sampler: {sampler!r} found, one of {', '.join(samplers)} allowed")
        self._pair = samplers[sampler]
        self._hash = mi.sample_tea_32(pixel, seed, 6)

    def in_pixel(self, step: mi.UInt32, count: int) -> mi.Point2f:
        """Point number ``step`` of ``count`` in the pixel."""
        return mi.Point2f(self._pair(1, step, count, *self._hashes(0)))

    def direction(self, index: mi.UInt32, count: int) -> mi.Point2f:
        """Point number ``index`` of ``count`` for the first direction of diffuse paths.

        The first two dimensions of Sobol's points are the most even ones, and directions need it most.
        """
        return mi.Point2f(self._pair(0, index, count, *self._hashes(1)))

    def lobe(self, index: mi.UInt32, count: int) -> tuple[mi.Float, mi.Point2f]:
        """A number that chooses the lobe, and a point for the first direction, of glossy paths."""
        return (
            self._pair(1, index, count, *self._hashes(2))[0],
            mi.Point2f(self._pair(0, index, count, *self._hashes(3))),
        )

    def generator(self, step: mi.UInt32) -> mi.PCG32:
        """Independent numbers for what comes after the first direction."""
        state = mi.sample_tea_32(self._hash[0] + step, self._hash[1], 4)
        return mi.PCG32(initstate=mi.UInt64(state[0]) << 32 | mi.UInt64(state[1]), initseq=mi.UInt64(step))

    def _hashes(self, stream: int) -> tuple[mi.UInt32, mi.UInt32]:
        first, second = mi.sample_tea_32(self._hash[1], self._hash[0] + stream, 6)
        return mi.UInt32(first), mi.UInt32(second)


def _recurrence(
    pair: int, index: mi.UInt32, count: int, first: mi.UInt32, second: mi.UInt32
) -> list[mi.Float]:
    return [
        _fraction(mi.Float64(shift) * 2.0**-32 + mi.Float64(index) * rate)
        for shift, rate in zip((first, second), _STEPS[2 * pair :], strict=False)
    ]


def _independent(
    pair: int, index: mi.UInt32, count: int, first: mi.UInt32, second: mi.UInt32
) -> list[mi.Float]:
    return [_unit(value) for value in mi.sample_tea_32(first + index, second, 6)]


def _stratified(
    pair: int, index: mi.UInt32, count: int, first: mi.UInt32, second: mi.UInt32
) -> list[mi.Float]:
    columns = max(k for k in range(1, math.isqrt(count) + 1) if count % k == 0)
    cell = mi.permute_kensler(index, count, first)
    x, y = _independent(pair, index, count, second, first)
    return [(mi.Float(cell % columns) + x) / columns, (mi.Float(cell // columns) + y) / (count // columns)]


def _sobol(pair: int, index: mi.UInt32, count: int, first: mi.UInt32, second: mi.UInt32) -> list[mi.Float]:
    reversed_bits = _even_pair(index) if pair == 0 else _other_pair(index)
    return [
        _unit(dr.brev(_owen(bits, seed))) for bits, seed in zip(reversed_bits, (first, second), strict=True)
    ]


def _even_pair(index: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
    """First and second dimension of Sobol's points, bits reversed.

    The first is the number itself. The second one's matrix is Pascal's triangle modulo 2: bit j is the sum of
    all bits whose places contain those of j in binary, which takes a step for each binary digit of j.
    """
    second = index
    for shift, mask in _ABOVE.items():
        second = second ^ ((second >> shift) & mask)  # not in place: that would change the first
    return index, second


def _other_pair(index: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
    """Third and fourth dimension, bits reversed."""
    values = [mi.UInt32(0), mi.UInt32(0)]
    for bit in range(_BITS):
        chosen = (index & (1 << bit)) != 0
        values = [
            value ^ dr.select(chosen, mi.UInt32(column[bit]), 0)
            for value, column in zip(values, _SOBOL, strict=True)
        ]
    return dr.brev(values[0]), dr.brev(values[1])


def _owen(reversed_bits: mi.UInt32, seed: mi.UInt32) -> mi.UInt32:
    """Nested uniform scrambling of a number whose bits are reversed: the hash of Burley (2020), listing 3."""
    x = reversed_bits + seed
    for factor in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
        x ^= x * factor
    return x


def _unit(bits: mi.UInt32) -> mi.Float:
    return dr.minimum(mi.Float(bits) * 2.0**-32, _BELOW_ONE)


def _fraction(value: mi.Float64) -> mi.Float:
    return dr.minimum(mi.Float(value - dr.floor(value)), _BELOW_ONE)
