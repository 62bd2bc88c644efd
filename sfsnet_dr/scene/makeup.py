"""Make-up on some faces: foundation, rouge, lip colour, lids and lash line."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.scene.face_zones import FaceZones
from sfsnet_dr.scene.head_regions import RegionWeights
from sfsnet_dr.scene.person import Person

Array = NDArray[np.float64]

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
        albedo = _mix(albedo, colour, weights.lips * rng.uniform(0.25, 0.9))
        gloss = weights.lips * shine
    if lids < 0.6:
        colour = _SHADOWS[rng.integers(len(_SHADOWS))] * (0.4 + 1.2 * (1.0 - person.darkness))
        albedo = _mix(albedo, colour, np.minimum(1.0, 1.2 * zones.socket) * rng.uniform(0.15, 0.6))
    if rouge < 0.6:
        flushed = albedo * (1.02, 0.72, 0.76)
        albedo = _mix(albedo, flushed, zones.cheek * rng.uniform(0.2, 0.9))
    if lash < 0.7:
        albedo = _mix(albedo, _KOHL, zones.lash * rng.uniform(0.5, 0.95))
    return albedo, gloss


def _mix(below: Array, above: Array, weight: Array) -> Array:
    w = np.clip(weight, 0.0, 1.0)[:, None]
    return np.asarray((1.0 - w) * below + w * above)
