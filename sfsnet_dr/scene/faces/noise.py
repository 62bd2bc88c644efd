"""Band-limited noise over a head: many fields for one matrix product.

Reading noise at 80,000 points costs tens of milliseconds a field, whether waves are summed or a volume is
looked up. So a head keeps 24 fields of each octave, and a person's field is a random mixture of those.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.scene.faces.per_head_cache import cached_per_head
from sfsnet_dr.scene.faces.regions import RegionWeights

Array = NDArray[np.float64]
Fields = NDArray[np.float32]

#: Fields of an octave that are kept. Two persons' mixtures correlate by 1 / sqrt(24) = 0.2 at random.
RANK: Final = 24

_SIZE = 64  # grid points a period of the volume, each way
_LOWEST, _HIGHEST = 5.0, 10.0  # cycles a period: waves of 6 to 13 grid points, which interpolate well
_CENTRE = (_LOWEST * _HIGHEST) ** 0.5
_TOGETHER = 4  # fields in the volume
_SEED = 20240917  # of the volume and of where heads read it


class NoiseBank:
    """Noise on one head.

    Args:
        position: (V, 3) in any unit.
    """

    def __init__(self, position: Array) -> None:
        self._position = position.astype(np.float32)
        self._octaves: dict[float, Fields] = {}

    def draw(self, frequency: float, count: int, rng: np.random.Generator) -> Array:
        """Fields of zero mean and unit variance, close to Gaussian and uncorrelated with each other.

        Fields of different frequencies are independent. The first call for a frequency costs about a second.

        Args:
            frequency: centre of the octave, in cycles per unit of position.
            count: 1 to ``RANK``.
            rng: mixes the head's fields; always draws the same count of numbers.

        Returns:
            (V, count).
        """
        mixture, _ = np.linalg.qr(rng.normal(size=(RANK, count)))
        return (self._octave(frequency) @ mixture.astype(np.float32)).astype(np.float64)

    def _octave(self, frequency: float) -> Fields:
        if frequency not in self._octaves:
            rng = np.random.default_rng((_SEED, round(1000 * frequency)))
            reads = [read_noise(self._position, frequency, rng) for _ in range(RANK // _TOGETHER)]
            self._octaves[frequency] = np.concatenate(reads, axis=1)
        return self._octaves[frequency]


@cached_per_head
def noise_bank(weights: RegionWeights) -> NoiseBank:
    """The noise of a head, anchored on its neutral shape."""
    return NoiseBank(weights.neutral)


def read_noise(position: Fields, frequency: float, rng: np.random.Generator) -> Fields:
    """Four independent fields read out of the volume, turned and shifted at random.

    The pattern repeats after seven waves, along directions that are turned with it.

    Args:
        position: (V, 3).
        frequency: in cycles per unit of ``position``.
        rng: gives the rotation and the shift.

    Returns:
        (V, 4).
    """
    volume = _volume().reshape(-1, _TOGETHER)
    turn = _rotation(rng) * (frequency * _SIZE / _CENTRE)
    points = position @ turn.T.astype(np.float32) + rng.uniform(0, _SIZE, 3).astype(np.float32)
    floor = np.floor(points)
    part = points - floor
    low = floor.astype(np.int64) % _SIZE
    sides = low, (low + 1) % _SIZE
    total = np.zeros((len(position), _TOGETHER), dtype=np.float32)
    for i, j, k in np.ndindex(2, 2, 2):
        index = (sides[i][:, 0] * _SIZE + sides[j][:, 1]) * _SIZE + sides[k][:, 2]
        x, y, z = (part[:, a] if high else 1 - part[:, a] for a, high in enumerate((i, j, k)))
        total += (x * y * z)[:, None] * volume[index]
    return total


@cache
def _volume() -> Fields:
    """(64, 64, 64, 4) periodic noise of one octave, scaled for unit variance after interpolation."""
    white = np.random.default_rng(_SEED).normal(size=(_TOGETHER, _SIZE, _SIZE, _SIZE))
    cycles = np.fft.fftfreq(_SIZE, 1.0 / _SIZE)
    x, y, z = np.meshgrid(cycles, cycles, cycles, indexing="ij")
    radius = np.sqrt(x * x + y * y + z * z)
    band = (radius >= _LOWEST) & (radius <= _HIGHEST)
    spectrum = np.fft.fftn(white, axes=(1, 2, 3)) * band
    # Mean power that linear interpolation between grid points keeps of a wave, per axis.
    kept = [(2.0 + np.cos(2 * np.pi * axis / _SIZE)) / 3.0 for axis in (x, y, z)]
    power = np.sum(np.abs(spectrum) ** 2 * kept[0] * kept[1] * kept[2], axis=(1, 2, 3)) / _SIZE**6
    fields = np.fft.ifftn(spectrum, axes=(1, 2, 3)).real / np.sqrt(power)[:, None, None, None]
    return np.ascontiguousarray(np.moveaxis(fields, 0, -1), dtype=np.float32)


def _rotation(rng: np.random.Generator) -> Array:
    """A uniformly random rotation (3, 3), from a normalised Gaussian quaternion."""
    gaussian = rng.normal(size=4)
    w, x, y, z = gaussian / np.linalg.norm(gaussian)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
