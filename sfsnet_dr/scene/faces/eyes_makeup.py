"""Colours of eyes, teeth, tongue and make-up."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.scene.faces.noise import noise_bank
from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.faces.regions import IRIS_DEGREES, PUPIL_DEGREES, RegionWeights, smoothstep
from sfsnet_dr.scene.faces.zones import FaceZones

Array = NDArray[np.float64]

#: Linear albedo of irises: dark brown, brown, hazel, green, blue, grey.
IRISES: Final = np.array(
    [
        [0.036, 0.011, 0.004],
        [0.105, 0.036, 0.008],
        [0.130, 0.066, 0.016],
        [0.070, 0.075, 0.042],
        [0.050, 0.090, 0.150],
        [0.095, 0.110, 0.120],
    ]
)
_LIGHT_SKIN: Final = np.array([0.15, 0.25, 0.16, 0.12, 0.22, 0.10])
_DARK_SKIN: Final = np.array([0.78, 0.20, 0.02, 0.0, 0.0, 0.0])
SCLERA: Final = np.array([0.56, 0.50, 0.46])
PUPIL: Final = np.array([0.006, 0.006, 0.006])
TEETH: Final = np.array([0.58, 0.52, 0.42])
MOUTH: Final = np.array([0.22, 0.070, 0.060])
TONGUE: Final = np.array([0.34, 0.115, 0.105])


def paint_eyes(
    albedo: Array, weights: RegionWeights, zones: FaceZones, person: Person, rng: np.random.Generator
) -> Array:
    """Paint sclera, iris and pupil over (V, 3) albedo: brown eyes for dark skin, any for light skin."""
    light = (1.0 - person.darkness) ** 2.2
    iris = IRISES[rng.choice(len(IRISES), p=light * _LIGHT_SKIN + (1.0 - light) * _DARK_SKIN)]
    iris = iris * rng.uniform(0.7, 1.4)
    inside = np.flatnonzero(weights.eyeball > 0.0)
    field = noise_bank(weights).draw(22.0, 2, rng)[inside]
    angle = weights.gaze_angle[inside]
    veins = np.clip(rng.uniform(0.0, 0.5) * smoothstep(30.0, 75.0, angle) + 0.06 * field[:, 0], 0.0, 1.0)
    white = SCLERA * rng.uniform(0.85, 1.1) * (1.0, 1.0 - 0.05 * person.wear, 1.0 - 0.12 * person.wear)
    colour = white * (1.0 - veins[:, None] * (0.15, 0.40, 0.40))
    ring = 1.0 - 0.6 * smoothstep(IRIS_DEGREES - 7.0, IRIS_DEGREES - 1.0, angle)
    lit = (1.0 + 0.20 * field[:, 1]) * ring
    colour = _mix(colour, iris * lit[:, None], smoothstep(IRIS_DEGREES + 1.5, IRIS_DEGREES - 1.5, angle))
    colour = _mix(colour, PUPIL, smoothstep(PUPIL_DEGREES + 1.5, PUPIL_DEGREES - 1.5, angle))
    albedo = albedo.copy()
    albedo[inside] = _mix(albedo[inside], colour, weights.eyeball[inside])
    return albedo


def paint_mouth(albedo: Array, weights: RegionWeights, person: Person, rng: np.random.Generator) -> Array:
    """Paint the inside of the mouth, tongue and teeth over (V, 3) albedo."""
    yellow = rng.uniform(0.0, 0.35) + 0.3 * person.wear
    teeth = TEETH * rng.uniform(0.8, 1.15) * (1.0, 1.0 - 0.15 * yellow, 1.0 - 0.45 * yellow)
    albedo = _mix(albedo, MOUTH * rng.uniform(0.7, 1.2), weights.mouth_inside)
    albedo = _mix(albedo, TONGUE * rng.uniform(0.8, 1.1), weights.tongue)
    return _mix(albedo, teeth, weights.teeth)


def _mix(below: Array, above: Array, weight: Array) -> Array:
    w = np.clip(weight, 0.0, 1.0)[:, None]
    return np.asarray((1.0 - w) * below + w * above)


#: Linear albedo of lip colours: red, berry, rose, coral, brown, dark plum.
LIPSTICKS: Final = np.array(
    [
        [0.34, 0.018, 0.022],
        [0.20, 0.020, 0.040],
        [0.42, 0.130, 0.140],
        [0.48, 0.110, 0.070],
        [0.19, 0.065, 0.045],
        [0.07, 0.012, 0.020],
    ]
)
#: Linear albedo of eye shadows: taupe, brown, plum, grey, blue.
_SHADOWS: Final = np.array(
    [[0.16, 0.10, 0.075], [0.09, 0.045, 0.025], [0.12, 0.05, 0.075], [0.07, 0.07, 0.07], [0.08, 0.11, 0.19]]
)
_KOHL: Final = np.array([0.010, 0.008, 0.008])


def paint_makeup(
    albedo: Array, weights: RegionWeights, zones: FaceZones, person: Person, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Paint make-up over (V, 3) skin; half of the women wear some, each part of it by chance.

    Returns:
        The albedo, and (V,) how far a glossy layer lies on the lips, in [0, 1].
    """
    lips, lids, rouge, lash, shine = rng.random(5)
    gloss = np.zeros(len(albedo))
    if person.male > 0.5 or rng.random() > 0.5:
        return albedo, gloss
    if lips < 0.75:
        colour = (
            LIPSTICKS[rng.integers(len(LIPSTICKS))] * rng.uniform(0.8, 1.2) * (1.0 - 0.5 * person.darkness)
        )
        albedo = _mix_makeup(albedo, colour, weights.lips * rng.uniform(0.25, 0.9))
        gloss = weights.lips * shine
    if lids < 0.6:
        colour = _SHADOWS[rng.integers(len(_SHADOWS))] * (0.4 + 1.2 * (1.0 - person.darkness))
        albedo = _mix_makeup(albedo, colour, np.minimum(1.0, 1.2 * zones.socket) * rng.uniform(0.15, 0.6))
    if rouge < 0.6:
        flushed = albedo * (1.02, 0.72, 0.76)
        albedo = _mix_makeup(albedo, flushed, zones.cheek * rng.uniform(0.2, 0.9))
    if lash < 0.7:
        albedo = _mix_makeup(albedo, _KOHL, zones.lash * rng.uniform(0.5, 0.95))
    return albedo, gloss


def _mix_makeup(below: Array, above: Array, weight: Array) -> Array:
    w = np.clip(weight, 0.0, 1.0)[:, None]
    return np.asarray((1.0 - w) * below + w * above)
