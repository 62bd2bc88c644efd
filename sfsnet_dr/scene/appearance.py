"""A seeded albedo map over the head: plain colours by region with band-limited variation.

The colours are linear Rec. 709 reflectances. The skin tones run along a line between measured extremes of
light and dark skin; a spectral skin model can take this file's place without a change elsewhere.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.head_regions import IRIS_DEGREES, PUPIL_DEGREES, RegionWeights, smoothstep

Array = npt.NDArray[np.float64]

# Dark to light, from the reflectance of the skin models of Jacques (melanin fraction .43, .16, .063, .013).
SKIN_TONES = np.array([[0.085, 0.045, 0.030], [0.24, 0.115, 0.070], [0.40, 0.235, 0.165], [0.56, 0.40, 0.32]])
HAIR = np.array([[0.015, 0.012, 0.010], [0.06, 0.035, 0.02], [0.28, 0.17, 0.08], [0.35, 0.34, 0.33]])
IRIS = np.array([[0.05, 0.025, 0.012], [0.10, 0.16, 0.22], [0.10, 0.13, 0.07]])
EYE_WHITE = np.array([0.62, 0.58, 0.55])
PUPIL = np.array([0.008, 0.008, 0.008])
TEETH = np.array([0.60, 0.55, 0.45])
MOUTH = np.array([0.22, 0.07, 0.06])
_BLOOD = np.array([1.06, 0.80, 0.84])  # what more blood under the skin does to each colour


def band_noise(position: Array, rng: np.random.Generator, low: float, high: float, terms: int = 48) -> Array:
    """Band-limited noise of zero mean and unit variance at 3D points: a sum of random plane waves.

    Args:
        position: (V, 3).
        low, high: spatial frequencies in cycles per unit of ``position``.
        terms: number of waves; 48 give a field that is close to Gaussian.
    """
    direction = rng.normal(size=(terms, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    frequency = low * (high / low) ** rng.random(terms)
    phase = rng.uniform(0, 2 * np.pi, terms)
    waves = np.cos(2 * np.pi * (position @ (direction * frequency[:, None]).T) + phase)
    return np.asarray(waves.sum(axis=1) * np.sqrt(2.0 / terms))


def skin_albedo(weights: RegionWeights, rng: np.random.Generator) -> Array:
    """Albedo of one seeded person.

    Returns:
        (V, 3) linear reflectance in [.004, .9].
    """
    position = weights.neutral
    tone = rng.random() * (len(SKIN_TONES) - 1)
    base = _between(SKIN_TONES, tone) * (1.0 + 0.06 * rng.normal(size=3) * (1.0, 0.7, 0.7))
    albedo = np.tile(base, (len(position), 1))
    blotches = band_noise(position, rng, 0.4, 2.0)[:, None] * rng.uniform(0.02, 0.07)
    grain = band_noise(position, rng, 4.0, 12.0)[:, None] * rng.uniform(0.01, 0.04)
    albedo = albedo * (1.0 + blotches + grain)
    flush = rng.uniform(0.0, 0.8) * _cheeks(position) * (1.0 + 0.3 * band_noise(position, rng, 1.0, 3.0))
    albedo = _mix(albedo, albedo * _BLOOD, np.clip(flush, 0.0, 1.0))
    albedo = _mix(albedo, albedo * rng.uniform(0.6, 0.95), weights.eyelid)
    lips = base * _BLOOD ** rng.uniform(1.0, 3.0) * rng.uniform(0.6, 0.95)
    albedo = _mix(albedo, lips, weights.lips)
    hair = _between(HAIR, min(rng.exponential(0.6), len(HAIR) - 1.0))
    strands = hair * (1.0 + 0.25 * band_noise(position, rng, 6.0, 20.0)[:, None])
    albedo = _mix(albedo, strands, weights.brow * rng.uniform(0.45, 0.95))
    albedo = _mix(albedo, strands, weights.scalp * rng.choice([0.95, 0.95, 0.95, 0.15]))
    albedo = _mix(albedo, MOUTH, np.maximum(weights.mouth_inside, weights.tongue))
    albedo = _mix(albedo, TEETH, weights.teeth)
    return np.clip(_eyes(albedo, weights, rng), 0.004, 0.9)


def _eyes(albedo: Array, weights: RegionWeights, rng: np.random.Generator) -> Array:
    iris = IRIS[rng.choice(len(IRIS), p=(0.6, 0.25, 0.15))] * rng.uniform(0.6, 1.5)
    albedo = _mix(albedo, EYE_WHITE, weights.eyeball)
    angle = weights.gaze_angle
    albedo = _mix(albedo, iris, smoothstep(IRIS_DEGREES + 2, IRIS_DEGREES - 2, angle))
    return _mix(albedo, PUPIL, smoothstep(PUPIL_DEGREES + 1.5, PUPIL_DEGREES - 1.5, angle))


def _cheeks(position: Array) -> Array:
    """Cheeks and the tip of the nose, where blood lies close under the skin."""
    side = np.stack([np.abs(position[:, 0]), position[:, 1], position[:, 2]], axis=1)
    cheek = np.exp(-np.sum(((side - (0.48, 6.90, 1.25)) / 0.28) ** 2, axis=1))
    nose = np.exp(-np.sum(((side - (0.0, 6.90, 1.60)) / 0.18) ** 2, axis=1))
    return np.asarray(cheek + nose)


def _between(table: Array, position: float) -> Array:
    """Row of a table at a fractional position, linearly interpolated."""
    index = min(int(position), len(table) - 2)
    part = position - index
    return np.asarray((1.0 - part) * table[index] + part * table[index + 1])


def _mix(below: Array, above: Array, weight: Array) -> Array:
    w = np.clip(weight, 0.0, 1.0)[:, None]
    return np.asarray((1.0 - w) * below + w * above)
