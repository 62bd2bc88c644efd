"""What JPEG does to a picture, without writing one: colour subsampling and rounded cosine coefficients.

A JPEG file's entropy coding loses nothing, so this is the whole loss of a baseline encoder with the example
tables of the standard (ITU-T T.81, annex K) scaled by libjpeg's quality, and chroma halved both ways (4:2:0).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from sfsnet_dr.core.errors import InputError, check_shape

_LUMA = [
    [16, 11, 10, 16, 24, 40, 51, 61],
    [12, 12, 14, 19, 26, 58, 60, 55],
    [14, 13, 16, 24, 40, 57, 69, 56],
    [14, 17, 22, 29, 51, 87, 80, 62],
    [18, 22, 37, 56, 68, 109, 103, 77],
    [24, 35, 55, 64, 81, 104, 113, 92],
    [49, 64, 78, 87, 103, 121, 120, 101],
    [72, 92, 95, 98, 112, 100, 103, 99],
]
_CHROMA_CORNER = [[17, 18, 24, 47], [18, 21, 26, 66], [24, 26, 56, 99], [47, 66, 99, 99]]

#: Encoded R, G, B to Y, Cb, Cr (JFIF, full range, chroma around 0).
_TO_YCC = torch.tensor(
    [[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]], dtype=torch.float32
)


def simulate_jpeg(encoded: Tensor, quality: int | Sequence[int]) -> Tensor:
    """Pictures after a JPEG file.

    Args:
        encoded: (B, 3, H, W) display values in [0, 1]; other values are clipped, all are rounded to 8 bits.
        quality: 1 to 100, as libjpeg counts; one for all, or one for each picture.

    Returns:
        (B, 3, H, W), multiples of 1/255 in [0, 1].

    Raises:
        InputError: for another shape or quality.
    """
    sizes = check_shape("encoded", encoded, "B 3 H W")
    qualities = [quality] * sizes["B"] if isinstance(quality, int) else list(quality)
    if len(qualities) != sizes["B"] or not all(1 <= value <= 100 for value in qualities):
        raise InputError(f"quality: {quality} found, 1 to 100 allowed, one or as many as pictures")
    height, width = sizes["H"], sizes["W"]
    levels = (encoded.float().clamp(0, 1) * 255).round()
    # Edges are repeated up to whole blocks of 16, the area of one block of halved chroma.
    levels = functional.pad(levels, (0, -width % 16, 0, -height % 16), mode="replicate")
    planes = _mixed(_TO_YCC, levels).round()
    luma = _round_trip(planes[:, :1] - 128, _tables(_LUMA, qualities)) + 128
    halved = functional.avg_pool2d(planes[:, 1:], 2).round()
    chroma = _round_trip(halved, _tables(_chroma(), qualities))
    chroma = functional.interpolate(chroma, scale_factor=2, mode="bilinear", align_corners=False)
    rgb = _mixed(torch.linalg.inv(_TO_YCC), torch.cat([luma, chroma], dim=1))
    return rgb[..., :height, :width].round().clamp(0, 255) / 255


def _mixed(matrix: Tensor, planes: Tensor) -> Tensor:
    """Colours (B, 3, H, W) times a matrix (3, 3)."""
    return (matrix.to(planes.device) @ planes.flatten(2)).reshape(planes.shape)


def _round_trip(plane: Tensor, tables: Tensor) -> Tensor:
    """Cosine transform in blocks of 8 x 8, rounding by each picture's table (B, 8, 8), and back."""
    batch, channels, height, width = plane.shape
    blocks = plane.reshape(batch, channels, height // 8, 8, width // 8, 8).transpose(3, 4)
    basis = _cosines().to(plane.device)
    steps = tables.to(plane.device)[:, None, None, None]
    frequencies = (basis @ blocks @ basis.T / steps).round() * steps
    back = (basis.T @ frequencies @ basis).transpose(3, 4).reshape(plane.shape)
    return back.round().clamp(-128, 127)


@cache
def _cosines() -> Tensor:
    """(8, 8) orthonormal cosine transform, frequency by place."""
    places, waves = np.arange(8), np.arange(8)[:, None]
    basis = 0.5 * np.cos((2 * places + 1) * waves * np.pi / 16)
    basis[0] /= np.sqrt(2)
    return torch.from_numpy(basis).float()


def _tables(base: list[list[int]], qualities: list[int]) -> Tensor:
    """(B, 8, 8) steps of the coefficients."""
    scales = np.array([5000 // quality if quality < 50 else 200 - 2 * quality for quality in qualities])
    return torch.from_numpy(np.clip((np.array(base) * scales[:, None, None] + 50) // 100, 1, 255)).float()


def _chroma() -> list[list[int]]:
    table = np.full((8, 8), 99)
    table[:4, :4] = _CHROMA_CORNER
    return [[int(value) for value in row] for row in table]
