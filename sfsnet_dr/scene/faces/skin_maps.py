"""Maps of melanin, blood and oxygen over one person's skin, and the colours that follow from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.scene.faces.noise import noise_bank
from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.faces.regions import RegionWeights, smoothstep
from sfsnet_dr.scene.faces.skin_color import lightest_angle, melanin_for, skin_table
from sfsnet_dr.scene.faces.skin_optics import skin_reflectance
from sfsnet_dr.scene.faces.zones import FaceZones

Array = NDArray[np.float64]

LEAST_BLOOD, MOST_BLOOD = 0.0025, 0.020  # of the dermis, on the plain skin of the face
LEAST_MELANIN, MOST_MELANIN = 0.004, 0.5


@dataclass(frozen=True, eq=False)
class SkinMaps:
    """What the skin holds at each vertex.

    Attributes:
        melanin, blood, saturation: (V,), see ``skin_optics.skin_reflectance``.
        thickness: of the epidermis, cm.
        plain: melanin, blood and saturation of the skin that the maps vary about.
    """

    melanin: Array
    blood: Array
    saturation: Array
    thickness: float
    plain: tuple[float, float, float]

    def plain_reflectance(self) -> Array:
        """(31,) spectrum of the plain skin."""
        return skin_reflectance(*self.plain, self.thickness)

    def colour(self) -> Array:
        """(V, 3) linear Rec. 709 albedo."""
        return skin_table(self.thickness).look_up(self.melanin, self.blood, self.saturation)


def sample_skin(
    weights: RegionWeights, zones: FaceZones, person: Person, rng: np.random.Generator
) -> SkinMaps:
    """Pigments of one person.

    The plain skin has the person's typology angle. Region by region: more blood in cheeks, nose, ears and
    lips, more melanin about the eyes, less oxygen under them; freckles, moles and age spots; band-limited
    unevenness at three scales.
    """
    base_rng, melanin_rng, blood_rng, spot_rng = rng.spawn(4)
    base, blood, saturation, thickness = _plain_skin(person, base_rng)
    melanin_map = base * _melanin_pattern(weights, zones, person, melanin_rng)
    melanin_map = melanin_map + _spots(weights, zones, person, base, spot_rng)
    blood_map, saturation_map = _blood(weights, zones, person, blood, saturation, blood_rng)
    melanin_map = np.clip(melanin_map, LEAST_MELANIN, MOST_MELANIN)
    return SkinMaps(melanin_map, blood_map, saturation_map, thickness, (base, blood, saturation))


def _plain_skin(person: Person, rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Melanin, blood, saturation, thickness whose skin has the person's tone.

    Much blood keeps skin from being very light: there is less of it until the tone can be reached.
    """
    blood = float(np.exp(rng.uniform(np.log(0.25 * MOST_BLOOD), np.log(MOST_BLOOD))))
    saturation = float(rng.uniform(0.62, 0.78))
    thickness = float(rng.uniform(0.006, 0.010))
    while lightest_angle(blood, saturation, thickness) < person.tone and blood > LEAST_BLOOD:
        blood = max(LEAST_BLOOD, 0.9 * blood)
    return melanin_for(person.tone, blood, saturation, thickness), blood, saturation, thickness


def _melanin_pattern(
    weights: RegionWeights, zones: FaceZones, person: Person, rng: np.random.Generator
) -> Array:
    """(V,) factor on the plain skin's melanin: about 1."""
    dark = person.darkness
    coarse, fine, grain = (noise_bank(weights).draw(frequency, 1, rng) for frequency in (1.3, 6.0, 22.0))
    uneven = rng.uniform(0.05, 0.12) * coarse[:, 0] + rng.uniform(0.02, 0.07) * fine[:, 0]
    uneven = uneven + rng.uniform(0.01, 0.04) * grain[:, 0]
    sun = rng.uniform(0.0, 0.25) * (zones.forehead + zones.nose + 0.5 * zones.cheek)
    eyes = rng.uniform(0.05, 0.35) * (0.5 + dark) * (zones.socket + 0.8 * zones.under_eye)
    mouth = rng.uniform(0.0, 0.25) * dark * zones.perioral
    throat = rng.uniform(-0.25, 0.0) * smoothstep(6.15, 5.9, zones.place[:, 1])
    lips = rng.uniform(-0.6, 0.0 + 0.1 * dark) * weights.lips
    ears = rng.uniform(-0.1, 0.1) * weights.ear
    return np.asarray(np.exp(uneven + sun + eyes + mouth + throat + lips + ears))


def _spots(
    weights: RegionWeights, zones: FaceZones, person: Person, base: float, rng: np.random.Generator
) -> Array:
    """(V,) melanin to add: freckles, moles, age spots."""
    small, large = noise_bank(weights).draw(14.0, 1, rng), noise_bank(weights).draw(6.0, 2, rng)
    where = np.clip(zones.cheek + zones.nose + 0.35 * zones.forehead + 0.2 * large[:, 1], 0.0, 1.0)
    freckled = rng.random() < 0.45 * smoothstep(10.0, 45.0, np.asarray(person.tone))
    strength = rng.uniform(0.02, 0.09) if freckled else 0.0
    threshold = rng.uniform(0.6, 1.4)
    added = strength * where * smoothstep(threshold, threshold + 0.7, small[:, 0])
    aged = (rng.uniform(0.0, 0.02) + rng.uniform(0.0, 1.0) * base) * person.wear * (1.0 - weights.lips)
    added = added + aged * zones.front * smoothstep(1.5, 2.9, large[:, 0] + 0.5 * small[:, 0])
    return np.asarray(added + _moles(zones, person, base, rng))


def _moles(zones: FaceZones, person: Person, base: float, rng: np.random.Generator) -> Array:
    """A few round dark spots of 1 to 3 mm anywhere on the front of the head."""
    place, added = zones.place, np.zeros(len(zones.place))
    candidates = np.flatnonzero(zones.front > 0.9)
    for centre in rng.choice(candidates, size=int(rng.poisson(2.5)), replace=True):
        radius, depth = rng.uniform(0.008, 0.02), rng.uniform(0.05, 0.3) * (0.4 + person.darkness)
        near = np.flatnonzero(np.abs(place - place[centre]).max(axis=1) < 3 * radius)
        same_side = zones.signed_side[near] * zones.signed_side[centre] > 0
        away = np.linalg.norm(place[near] - place[centre], axis=1)
        added[near] += same_side * depth * np.exp(-((away / radius) ** 2))
    return added


def _blood(
    weights: RegionWeights,
    zones: FaceZones,
    person: Person,
    blood: float,
    saturation: float,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """(V,) blood and saturation."""
    coarse, fine = noise_bank(weights).draw(1.3, 3, rng), noise_bank(weights).draw(6.0, 2, rng)
    flush = min(1.0, rng.gamma(1.5, 0.3)) * np.array([1.0, 0.9, 0.6, 0.8]) * rng.uniform(0.5, 1.4, 4)
    log_blood = (
        flush[0] * zones.cheek * (1.0 + 0.35 * coarse[:, 0])
        + flush[1] * zones.nose
        + flush[2] * zones.chin
        + flush[3] * weights.ear
        + rng.uniform(0.1, 0.5) * (weights.eyelid + zones.under_eye)
        + rng.uniform(0.08, 0.2) * coarse[:, 1]
        + rng.uniform(0.05, 0.18) * fine[:, 0]
    )
    full = rng.uniform(0.018, 0.05)  # of the lips
    lips = np.log(full / blood) + 0.12 * fine[:, 1]
    log_blood = log_blood + weights.lips * (lips - log_blood)
    pale = rng.uniform(0.0, 0.12) * zones.under_eye
    oxygen = saturation + 0.02 * coarse[:, 2] - pale + 0.05 * weights.lips
    return np.clip(blood * np.exp(log_blood), 0.0012, 0.07), np.clip(oxygen, 0.45, 0.9)
