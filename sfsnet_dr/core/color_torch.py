"""The sRGB curve in torch, differentiable everywhere; twin of ``sfsnet_dr.core.color``.

As there, nothing is clipped: below 0 the straight piece goes on, above 1 the power piece.
"""

from __future__ import annotations

from torch import Tensor, where

_SLOPE = 12.92
_OFFSET = 0.055
_GAMMA = 2.4
_LINEAR_END = 0.0031308  # IEC 61966-2-1, in linear light
_ENCODED_END = 0.04045  # and after encoding


def srgb_to_linear(encoded: Tensor) -> Tensor:
    """Decode sRGB values of any shape into linear light; gradients are finite for every finite input."""
    # Each branch sees only values where its own gradient is finite: `where` multiplies the other's by 0.
    power = ((encoded.clamp_min(_ENCODED_END) + _OFFSET) / (1 + _OFFSET)) ** _GAMMA
    return where(encoded <= _ENCODED_END, encoded / _SLOPE, power)


def linear_to_srgb(linear: Tensor) -> Tensor:
    """Encode linear light of any shape with the sRGB curve; the inverse of :func:`srgb_to_linear`."""
    power = (1 + _OFFSET) * linear.clamp_min(_LINEAR_END) ** (1 / _GAMMA) - _OFFSET
    return where(linear <= _LINEAR_END, linear * _SLOPE, power)
