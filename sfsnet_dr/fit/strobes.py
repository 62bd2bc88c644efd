"""How strong the lamps of a photometric-stereo rig were, from its pictures.

Two things make a picture brighter than the Lambertian model with lamps of equal strength: lamps differ (the
same for everybody they lit), and oblique light is brighter on skin than the model says (scattering, gloss,
light from the walls). So the gain of light j is

    g_j = s_j (1 + k (1 - l_z)),

with s_j of geometric mean 1. A pixel's three unknowns can absorb part of any gain that grows with the angle,
which makes k and the trend of s_j with l_z hard to tell apart by the residual alone: k is therefore the value
for which the s_j found with it show no trend with l_z, as lamps that are mounted alike should not. Lamps
beside and behind the face have no say in that: they light a rim only, and the walls.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.fit.photometric_stereo import fit_pixels, is_valid

Array = npt.NDArray[np.float64]

#: Lights of a capture below which gains cannot be told from shape; they are then taken to be 1.
FEWEST_FOR_GAINS: Final = 12
#: Largest k; a slope beyond it would be no property of skin.
_STEEPEST: Final = 1.0
_ROUNDS: Final = 3
#: Least l_z of the lights in which a trend is looked for.
_IN_FRONT: Final = 0.05
#: A pixel says something about a lamp that it faces at least this much, and that its fit trusts this much.
_FACING: Final = 0.25
_TRUSTED: Final = 0.3
_FEWEST_PIXELS: Final = 50


@dataclass(frozen=True, eq=False)
class Shots:
    """Pixels of one capture under its lights.

    Attributes:
        values: linear, 0 to 1, (P, N).
        directions: unit vectors toward the lights, (N, 3).
        lights: their names, N; a name means the same lamp in every capture.
    """

    values: Array
    directions: Array
    lights: tuple[str, ...]


@dataclass(frozen=True)
class Strobes:
    """Strengths of lamps by name, and the slope of the oblique gain.

    Attributes:
        strength: s_j; names that are not in it have 1.
        oblique: k.
        spread: standard deviation of log s_j over the captures, mean of all lamps: how far the captures
            disagree about a lamp; 0 with fewer than two captures.
    """

    strength: Mapping[str, float] = field(default_factory=dict)
    oblique: float = 0.0
    spread: float = 0.0

    def gains(self, lights: Sequence[str], directions: Array) -> Array:
        """g_j of lights by name and direction, (N,)."""
        own = np.array([self.strength.get(light, 1.0) for light in lights])
        return np.asarray(own * _oblique(self.oblique, directions))


def estimate_strobes(captures: Sequence[Shots]) -> Strobes:
    """Gains that all captures share.

    Args:
        captures: with the same lamps; a thousand pixels of each are enough. Those with fewer than 12 lights
            are left out, and without any others all gains are 1.

    Raises:
        BadInput: if no capture is given.
    """
    if not captures:
        raise BadInput("captures: none found, at least one is needed")
    chosen = [shots for shots in captures if len(shots.lights) >= FEWEST_FOR_GAINS]
    if not chosen:
        return Strobes()
    heights = {name: z for s in chosen for name, z in zip(s.lights, s.directions[:, 2], strict=True)}
    # The trend falls about linearly with k: two values give its root, a third corrects it.
    low, high = 0.0, 0.5
    trends = [_trend(_strengths(chosen, k)[0], heights) for k in (low, high)]
    oblique = _root(low, high, *trends)
    oblique = _root(low, oblique, trends[0], _trend(_strengths(chosen, oblique)[0], heights))
    strength, spread = _strengths(chosen, oblique)
    return Strobes(strength, oblique, spread)


def _root(a: float, b: float, at_a: float, at_b: float) -> float:
    if abs(at_b - at_a) < 1e-6:
        return a
    return float(np.clip(a - at_a * (b - a) / (at_b - at_a), 0.0, _STEEPEST))


def _trend(strength: Mapping[str, float], heights: Mapping[str, float]) -> float:
    """Slope of log s_j over l_z."""
    names = sorted(name for name in strength if heights[name] > _IN_FRONT)
    if len(names) < FEWEST_FOR_GAINS // 2:
        return 0.0
    x, y = np.array([heights[name] for name in names]), np.log([strength[name] for name in names])
    return float(np.cov(x, y, bias=True)[0, 1] / np.var(x))


def _strengths(captures: Sequence[Shots], oblique: float) -> tuple[dict[str, float], float]:
    """s_j for a given k by turns of fitting the surface and the lamps, and the captures' disagreement."""
    strength: dict[str, float] = {}
    ratios: dict[str, list[float]] = {}
    for _ in range(_ROUNDS):
        ratios = {}
        for shots in captures:
            own = np.array([strength.get(light, 1.0) for light in shots.lights])
            _add_ratios(ratios, shots, own * _oblique(oblique, shots.directions))
        found = {name: strength.get(name, 1.0) * float(np.median(r)) for name, r in ratios.items()}
        mean = float(np.exp(np.mean(np.log(list(found.values())))))
        strength = {name: value / mean for name, value in found.items()}
    several = [float(np.std(np.log(r))) for r in ratios.values() if len(r) > 1]
    return strength, float(np.mean(several)) if several else 0.0


def _add_ratios(ratios: dict[str, list[float]], shots: Shots, gains: Array) -> None:
    """What each light shows over what the model says, the median of its trusted pixels."""
    values, valid = shots.values / gains, is_valid(shots.values)
    scaled, weights = fit_pixels(values, valid, shots.directions, rounds=8)
    model = scaled @ shots.directions.T
    size = np.linalg.norm(scaled, axis=1, keepdims=True)
    trusted = (valid > 0) & (model > _FACING * size) & (weights > _TRUSTED)
    for j, light in enumerate(shots.lights):
        pixels = trusted[:, j]
        if pixels.sum() >= min(_FEWEST_PIXELS, len(values) // 4):
            ratios.setdefault(light, []).append(float(np.median(values[pixels, j] / model[pixels, j])))


def _oblique(slope: float, directions: Array) -> Array:
    return np.asarray(1 + slope * (1 - directions[:, 2]))
