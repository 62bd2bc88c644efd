"""How strong the lamps of a photometric-stereo rig were, from its pictures.

Two things make a picture brighter than the Lambertian model with lamps of equal strength: lamps differ (the
same for everybody they lit), and oblique light is brighter on skin than the model says (scattering, gloss,
light from the walls). So the gain of light j is

    g_j = s_j (1 + k (1 - l_z)),

with s_j of geometric mean 1. Both are found from what no surface can explain:

- k leaves the least robust residual, the sum that ``fit_pixels`` makes small. A pixel's three unknowns absorb
  most of any gain that grows with the angle, so the minimum is shallow, but it lies where gains were planted.
- s_j is what light j shows over the model, the median of pixels and captures. What the model lacks (light
  from other parts of the face, gloss, soft shadows) gets in here too, so two things are taken out: the trend
  of log s_j with l_z, which lamps that are mounted alike do not have and oblique light does; and, by
  shrinking log s_j, as much as four parts of the face disagree about a lamp, which changes all of them alike.

Rendered faces with equal lamps then keep the normals that equal gains give within 0.2 degrees.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.estimation.photometric_stereo import GRAZING, SCALE, fit_pixels, is_valid

Array = npt.NDArray[np.float64]

#: Lights of a capture below which gains cannot be told from shape; they are then taken to be 1.
FEWEST_FOR_GAINS: Final = 12
#: Largest k; a slope beyond it would be no property of skin.
_STEEPEST: Final = 1.0
#: How exactly k is sought; its own uncertainty is a few times that.
_EXACT: Final = 0.01
_ROUNDS: Final = 5
#: Rounds of reweighting in each fit of the surfaces.
_REWEIGHTED: Final = 8
#: A pixel says something about a lamp that it faces at least this much, and that its fit trusts this much.
_FACING: Final = 0.25
_TRUSTED: Final = 0.3
_FEWEST_PIXELS: Final = 50
#: The same for a part of the face, of which there are four.
_FEWEST_IN_PART: Final = 10
#: Variance of log s_j where fewer than two parts of the face see a lamp.
_UNKNOWN: Final = 0.01


@dataclass(frozen=True, eq=False)
class LightImages:
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
class LightIntensities:
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


def estimate_light_intensities(captures: Sequence[LightImages]) -> LightIntensities:
    """Gains that all captures share.

    Args:
        captures: with the same lamps; a thousand pixels of each are enough. Those with fewer than 12 lights
            are left out, and without any others all gains are 1.

    Raises:
        InputError: if no capture is given.
    """
    if not captures:
        raise InputError("captures: none found, at least one is needed")
    chosen = [shots for shots in captures if len(shots.lights) >= FEWEST_FOR_GAINS]
    if not chosen:
        return LightIntensities()
    oblique = _slope(chosen, {})
    strength, spread = _strengths(chosen, oblique)
    return LightIntensities(strength, _slope(chosen, strength), spread)


def _slope(captures: Sequence[LightImages], strength: Mapping[str, float]) -> float:
    """k of the least residual for given s_j."""

    def misfit(slope: float) -> float:
        gains = LightIntensities(strength, slope)
        return float(np.mean([_misfit(s, gains.gains(s.lights, s.directions)) for s in captures]))

    # The bounded search never tries its ends, and lamps without any slope are the most likely ones.
    found = minimize_scalar(misfit, bounds=(0.0, _STEEPEST), method="bounded", options={"xatol": _EXACT})
    return 0.0 if misfit(0.0) <= found.fun else float(found.x)


def _misfit(shots: LightImages, gains: Array) -> float:
    """Mean of Cauchy's loss over the pixels that each light reaches."""
    values, valid = shots.values / gains, is_valid(shots.values)
    scaled, _ = fit_pixels(values, valid, shots.directions, rounds=_REWEIGHTED)
    model, size = scaled @ shots.directions.T, np.linalg.norm(scaled, axis=1, keepdims=True) + 1e-9
    reached = (valid > 0) & (model > GRAZING * size)
    return float(np.log1p(((values - model) / (SCALE * size))[reached] ** 2).mean()) if reached.any() else 0.0


def _strengths(captures: Sequence[LightImages], oblique: float) -> tuple[dict[str, float], float]:
    """s_j for a given k by turns of fitting the surface and the lamps, and the captures' disagreement."""
    heights = {name: z for s in captures for name, z in zip(s.lights, s.directions[:, 2], strict=True)}
    names: list[str] = []
    logs = np.zeros(0)
    ratios: dict[str, list[Array]] = {}
    for _ in range(_ROUNDS):
        known = LightIntensities(dict(zip(names, np.exp(logs), strict=True)), oblique)
        ratios = {}
        for shots in captures:
            _add_ratios(ratios, shots, known.gains(shots.lights, shots.directions))
        seen = [np.log(known.strength.get(name, 1.0)) + _mean(ratios[name])[0] for name in sorted(ratios)]
        names, logs = sorted(ratios), np.array(seen)
        logs = _without_trend(logs, np.array([heights[name] for name in names]))
    logs = logs * _trust(logs, np.array([_doubt(_mean(ratios[name])[1:]) for name in names]))
    several = [float(np.std([row[0] for row in ratios[name]])) for name in names if len(ratios[name]) > 1]
    strength = {name: float(np.exp(value)) for name, value in zip(names, logs, strict=True)}
    return strength, float(np.mean(several)) if several else 0.0


def _without_trend(values: Array, heights: Array) -> Array:
    """Values without their mean and their slope over the heights, (N,)."""
    if len(values) < FEWEST_FOR_GAINS // 2:
        return np.zeros_like(values)
    basis = np.stack([np.ones_like(heights), heights], 1)
    return np.asarray(values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0])


def _doubt(parts: Array) -> float:
    """Variance of the mean over the parts of the face."""
    known = parts[np.isfinite(parts)]
    return float(known.var(ddof=1) / len(known)) if len(known) > 1 else _UNKNOWN


def _trust(logs: Array, doubts: Array) -> Array:
    """What to keep of each value: the lamps' own variance in shares of it and the value's uncertainty."""
    own = max(float(np.var(logs) - np.mean(doubts)), 0.0) if len(logs) else 0.0
    return np.asarray(own / (own + doubts + 1e-12))


def _mean(rows: Sequence[Array]) -> Array:
    """Mean over captures of what each said, where it said anything."""
    table = np.array(rows)
    known = np.isfinite(table)
    total = np.where(known, table, 0.0).sum(0)
    return np.asarray(np.where(known.any(0), total / np.maximum(known.sum(0), 1), np.nan))


def _add_ratios(ratios: dict[str, list[Array]], shots: LightImages, gains: Array) -> None:
    """Log of what each light shows over what the model says: of all trusted pixels, and of four parts."""
    values, valid = shots.values / gains, is_valid(shots.values)
    scaled, weights = fit_pixels(values, valid, shots.directions, rounds=_REWEIGHTED)
    model = scaled @ shots.directions.T
    size = np.linalg.norm(scaled, axis=1, keepdims=True)
    trusted = (valid > 0) & (model > _FACING * size) & (weights > _TRUSTED)
    parts = _parts(scaled / np.maximum(size, 1e-9))
    for j, light in enumerate(shots.lights):
        if trusted[:, j].sum() < min(_FEWEST_PIXELS, len(values) // 4):
            continue
        log = np.log(values[:, j] / np.where(trusted[:, j], model[:, j], np.inf) + 1e-12)
        medians = [np.median(log[trusted[:, j]])]
        for part in range(4):
            pixels = trusted[:, j] & (parts == part)
            medians.append(np.median(log[pixels]) if pixels.sum() >= _FEWEST_IN_PART else np.nan)
        ratios.setdefault(light, []).append(np.array(medians))


def _parts(normal: Array) -> npt.NDArray[np.intp]:
    """Which of four parts of the face a pixel is in, by where it faces: left or right, down or up."""
    right, up = (normal[:, axis] > np.median(normal[:, axis]) for axis in (0, 1))
    return np.asarray(2 * right.astype(np.intp) + up)


def _oblique(slope: float, directions: Array) -> Array:
    return np.asarray(1 + slope * (1 - directions[:, 2]))
