"""Fine relief: pores, wrinkles, lip furrows, and the body of brows, beard and hair, along the normals.

Its noise uses other octaves than the albedo's, so that bumps and spots are independent: a network cannot
learn to read one from the other. Heights are in millimetres until they are added.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.scene.faces.hair import Hair
from sfsnet_dr.scene.faces.noise import noise_bank
from sfsnet_dr.scene.faces.per_head_cache import cached_per_head
from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.faces.regions import RegionWeights, smoothstep
from sfsnet_dr.scene.faces.zones import FaceZones, face_zones

Array = NDArray[np.float64]

MILLIMETRE: Final = 0.01  # decimetres

#: Path of the fold from the wing of the nose past the corner of the mouth: side, height in Anny's frame.
_FOLD: Final = np.array([[0.17, 6.92], [0.23, 6.84], [0.30, 6.72], [0.345, 6.60], [0.36, 6.50]])
#: Path of the crease from the corner of the mouth down toward the chin.
_MOUTH: Final = np.array([[0.28, 6.57], [0.31, 6.48], [0.32, 6.38]])
#: Path of the groove under the eye, from its inner corner.
_TEAR: Final = np.array([[0.17, 7.19], [0.23, 7.125], [0.32, 7.10], [0.42, 7.14]])
_OUTER_CORNER: Final = (0.475, 7.285)  # of the eye: where crow's feet start

#: Depths in mm of forehead lines, frown, crow's feet, tear groove, fold and mouth crease: young, and added by
#: age.
_YOUNG: Final = np.array([0.06, 0.05, 0.03, 0.14, 0.18, 0.05])
_OLD: Final = np.array([0.34, 0.32, 0.28, 0.36, 0.60, 0.42])


@dataclass(frozen=True, eq=False)
class Grooves:
    """(V,) shapes of depth 1 that all persons share: tear groove, nose-to-mouth fold, mouth crease."""

    tear: Array
    fold: Array
    mouth: Array


def displace_mesh(
    vertices: Array,
    normals: Array,
    weights: RegionWeights,
    rng: np.random.Generator,
    person: Person | None = None,
    hair: Hair | None = None,
) -> Array:
    """Add fine relief to a head.

    Args:
        vertices: (V, 3) positions to move, in decimetres.
        normals: (V, 3) unit normals of ``vertices``; those of the neutral head come close enough.
        weights: regions of the head, where the patterns are anchored.
        rng: the only source of randomness.
        person: sets the wrinkles; sampled if not given.
        hair: raises brows, beard and scalp; without it these stay skin.

    Returns:
        (V, 3).
    """
    person_rng, skin_rng, crease_rng, hair_rng = rng.spawn(4)
    person = Person.sample(person_rng) if person is None else person
    zones = face_zones(weights)
    height = skin_relief(weights, zones, person, skin_rng) + crease_depth(weights, zones, person, crease_rng)
    height *= 1.0 - np.clip(weights.eyeball + weights.teeth + weights.tongue + weights.mouth_inside, 0.0, 1.0)
    if hair is not None:
        height = height * (1.0 - hair.cover()) + hair_relief(weights, zones, hair, hair_rng)
    return np.asarray(vertices + (MILLIMETRE * height)[:, None] * normals)


def skin_relief(weights: RegionWeights, zones: FaceZones, person: Person, rng: np.random.Generator) -> Array:
    """(V,) mm: uneven skin at wavelengths of 3, 6 and 11 mm, more with age; furrows across the lips."""
    bank = noise_bank(weights)
    fine, middle, coarse = bank.draw(32.0, 1, rng), bank.draw(17.0, 3, rng), bank.draw(9.0, 3, rng)
    rough = 0.7 + 0.8 * person.wear
    pores = rng.uniform(0.018, 0.060) * rough * (0.5 + zones.nose + zones.cheek + 0.5 * zones.forehead)
    patchy = np.clip(1.0 + 0.5 * coarse[:, 1], 0.2, 2.0)
    height = pores * patchy * fine[:, 0] + rng.uniform(0.03, 0.08) * rough * middle[:, 0]
    height = height + rng.uniform(0.03, 0.09) * rough * coarse[:, 0]
    height = height * (1.0 - 0.6 * weights.eyelid) * (1.0 - weights.lips)
    phase = 38.0 * weights.neutral[:, 0] + 0.35 * middle[:, 1] + 0.15 * coarse[:, 2]
    furrows = rng.uniform(0.01, 0.05) * np.sin(2 * np.pi * phase) * patchy + 0.02 * middle[:, 2]
    return np.asarray(height + weights.lips * furrows)


def crease_depth(weights: RegionWeights, zones: FaceZones, person: Person, rng: np.random.Generator) -> Array:
    """(V,) mm: wrinkles across the forehead, between the brows, beside and under the eyes, by the mouth."""
    side, height, _ = zones.place.T
    warp = noise_bank(weights).draw(2.0, 3, rng)
    broken = np.clip(0.7 + 0.5 * noise_bank(weights).draw(4.2, 1, rng)[:, 0], 0.0, 1.5)
    depths = rng.uniform(0.3, 1.0, 6) * _YOUNG + rng.uniform(0.2, 1.0, 6) * person.wear * _OLD
    lines = _valleys((height + 0.02 * warp[:, 0] + 0.10 * side**2) / rng.uniform(0.075, 0.11))
    lines = lines * zones.forehead * smoothstep(0.55, 0.35, side) * smoothstep(7.95, 7.85, height) * broken
    frown = _valleys(side / 0.11 + 0.5 + 0.25 * warp[:, 1]) * _window(side, 0.0, 0.13)
    frown = frown * _window(height, 7.50, 0.16) * zones.front
    crow = _crow_feet(side, height, warp[:, 2]) * zones.front * broken
    grooves = _grooves(weights)
    shapes = np.stack([lines, frown, crow, grooves.tear, grooves.fold, grooves.mouth])
    return np.asarray(-(depths @ shapes) * (1.0 - weights.lips))


def hair_relief(weights: RegionWeights, zones: FaceZones, hair: Hair, rng: np.random.Generator) -> Array:
    """(V,) mm: body of the hair, up to a millimetre in brows, two in beards, on the scalp by its length."""
    clumps, locks = noise_bank(weights).draw(32.0, 2, rng), noise_bank(weights).draw(9.0, 2, rng)
    rough = 1.0 + 0.18 * clumps[:, 0] + 0.15 * locks[:, 0]
    brow = 0.5 * hair.brow * rough
    beard = hair.beard * (1.0 - zones.mouth_corner) * (0.25 + 0.9 * smoothstep(0.5, 0.95, hair.beard)) * rough
    grown = smoothstep(0.0, 0.22, zones.hairline) * hair.scalp
    scalp = grown * (1.0 + 0.10 * locks[:, 0] + 0.08 * locks[:, 1]) * hair.length / MILLIMETRE
    stubble = 0.08 * hair.scalp * clumps[:, 1]
    return np.asarray(brow + beard + scalp + stubble)


@cached_per_head
def _grooves(weights: RegionWeights) -> Grooves:
    zones = face_zones(weights)
    return Grooves(
        tear=_groove(zones, _TEAR, 0.028),
        fold=_groove(zones, _FOLD, 0.032),
        mouth=_groove(zones, _MOUTH, 0.026),
    )


def _valleys(phase: Array) -> Array:
    """Narrow valleys of depth 1 at whole phases, flat between."""
    return np.asarray(np.exp(-(((phase + 0.5) % 1.0 - 0.5) ** 2) / 0.02))


def _window(value: Array, centre: float, width: float) -> Array:
    return np.asarray(np.exp(-(((value - centre) / width) ** 2)))


def _crow_feet(side: Array, height: Array, warp: Array) -> Array:
    """Rays from the outer corner of the eye toward the temple."""
    right, up = side - _OUTER_CORNER[0], height - _OUTER_CORNER[1]
    distance, angle = np.hypot(right, up), np.arctan2(up, np.maximum(right, 1e-6))
    rays = _valleys(angle / 0.42 + 0.25 * warp)
    return np.asarray(
        rays * smoothstep(0.01, 0.05, distance) * smoothstep(0.19, 0.10, distance) * (right > 0)
    )


def _groove(zones: FaceZones, path: Array, width: float) -> Array:
    """A valley of depth 1 along a path of (side, height) points, fading at its ends."""
    point = zones.place[:, :2]
    nearest = np.full(len(point), np.inf)
    position = np.zeros(len(point))
    steps = len(path) - 1
    for k in range(steps):
        start, edge = path[k], path[k + 1] - path[k]
        along = np.clip(((point - start) @ edge) / (edge @ edge), 0.0, 1.0)
        distance = np.linalg.norm(point - start - along[:, None] * edge, axis=1)
        closer = distance < nearest
        nearest = np.where(closer, distance, nearest)
        position = np.where(closer, (k + along) / steps, position)
    fade = smoothstep(0.0, 0.2, position) * smoothstep(1.0, 0.7, position)
    return np.asarray(np.exp(-((nearest / width) ** 2)) * fade * zones.front)
