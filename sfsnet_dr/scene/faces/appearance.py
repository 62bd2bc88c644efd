"""What a face's surface looks like: albedo and gloss of one seeded person, from pigments to make-up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.faces.eyes_makeup import paint_eyes, paint_makeup, paint_mouth
from sfsnet_dr.scene.faces.hair import Hair, sample_hair
from sfsnet_dr.scene.faces.noise import noise_bank
from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.faces.regions import RegionWeights, smoothstep
from sfsnet_dr.scene.faces.skin_color import skin_rgb, typology_angle
from sfsnet_dr.scene.faces.skin_maps import SkinMaps, sample_skin
from sfsnet_dr.scene.faces.zones import FaceZones, face_zones
from sfsnet_dr.scene.mesh import Region

Array = npt.NDArray[np.float64]

#: Bounds of the albedo: nothing is black to the last ray, nothing outshines paper.
LEAST_ALBEDO, GREATEST_ALBEDO = 0.003, 0.9


@dataclass(frozen=True, eq=False)
class Appearance:
    """Surface of one person.

    Attributes:
        albedo: (V, 3) linear Rec. 709 reflectance in [0.003, 0.9].
        roughness_mix: (V,) share of the shiny lobe against the dull one, in [0, 1].
        ita: individual typology angle of the person's plain skin, degrees.
        person: tone, sex and age.
        skin: the pigments behind the albedo.
        hair: cover of brows, beard and scalp.
    """

    albedo: Array
    roughness_mix: Array
    ita: float
    person: Person
    skin: SkinMaps
    hair: Hair

    def labels(self, labels: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Regions (V,) with the scalp where this person's hair begins, and skin where it ends.

        Args:
            labels: (V,) regions of the face model.
        """
        hairy, above = self.hair.scalp > 0.5, (labels == Region.SCALP) & (self.hair.scalp <= 0.5)
        bare = np.where(above, Region.SKIN, labels)
        return np.where(hairy & np.isin(bare, (Region.SKIN, Region.NECK)), Region.SCALP, bare).astype(
            np.uint8
        )


def skin_appearance(
    weights: RegionWeights, rng: np.random.Generator, person: Person | None = None
) -> Appearance:
    """The surface of one seeded person.

    Each part draws from a generator of its own, so that a change in one leaves the others as they were.

    Args:
        weights: regions of the neutral head, in decimetres.
        rng: the only source of randomness.
        person: tone, sex and age; sampled if not given.
    """
    person_rng, skin_rng, hair_rng, paint_rng, mouth_rng, eye_rng, gloss_rng = rng.spawn(7)
    person = Person.sample(person_rng) if person is None else person
    zones = face_zones(weights)
    skin = sample_skin(weights, zones, person, skin_rng)
    hair = sample_hair(weights, zones, person, hair_rng)
    albedo, lip_gloss = paint_makeup(skin.colour(), weights, zones, person, paint_rng)
    cover = hair.cover()[:, None]
    albedo = (1.0 - cover) * albedo + cover * hair.colour
    albedo = paint_mouth(albedo, weights, person, mouth_rng)
    albedo = paint_eyes(albedo, weights, zones, person, eye_rng)
    return Appearance(
        albedo=np.clip(albedo, LEAST_ALBEDO, GREATEST_ALBEDO),
        roughness_mix=_gloss(weights, zones, hair, lip_gloss, gloss_rng),
        ita=float(typology_angle(skin_rgb(skin.plain_reflectance()))),
        person=person,
        skin=skin,
        hair=hair,
    )


def _gloss(
    weights: RegionWeights, zones: FaceZones, hair: Hair, lip_gloss: Array, rng: np.random.Generator
) -> Array:
    """(V,) share of the shiny lobe: oily forehead, nose and chin, moist lips, wet eyes, dull hair."""
    uneven = noise_bank(weights).draw(3.0, 1, rng)
    oil = rng.uniform(0.1, 0.6)
    zone = 0.8 * zones.forehead + zones.nose + 0.5 * zones.chin + 0.4 * zones.cheek
    skin = np.clip(oil * (0.4 + zone) * (1.0 + 0.2 * uneven[:, 0]), 0.0, 1.0)
    lips = np.maximum(rng.uniform(0.4, 0.9), lip_gloss)
    mix = skin + weights.lips * (lips - skin)
    mix = mix * (1.0 - 0.8 * hair.cover())
    wet = np.maximum(np.maximum(weights.eyeball, weights.mouth_inside), weights.tongue + weights.teeth)
    return np.asarray(np.maximum(mix, smoothstep(0.2, 0.8, np.clip(wet, 0.0, 1.0))))
