"""Brows, beard and hair as cover over the skin: how much of it, and of what colour.

Hair is finer than the vertices, so that it is a share of covered skin, uneven in clumps, not strands.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.scene.faces.noise import noise_bank
from sfsnet_dr.scene.faces.person import Person
from sfsnet_dr.scene.faces.regions import RegionWeights, smoothstep
from sfsnet_dr.scene.faces.zones import FaceZones

Array = NDArray[np.float64]

#: Linear albedo of a mass of hair, from black to light blond, then red, then grey and white.
BLACK, DARK_BROWN, BROWN, DARK_BLOND, BLOND = (
    np.array(colour)
    for colour in (
        (0.010, 0.008, 0.007),
        (0.026, 0.016, 0.010),
        (0.060, 0.035, 0.019),
        (0.130, 0.083, 0.043),
        (0.270, 0.185, 0.100),
    )
)
RED: Final = np.array((0.140, 0.050, 0.018))
GREY: Final = np.array((0.300, 0.295, 0.285))
_NATURAL: Final = np.stack([BLACK, DARK_BROWN, BROWN, DARK_BLOND, BLOND])

#: Beards by (probability among men, cover of moustache, of chin, of jaw and cheeks), each a range.
_BEARDS: Final = (
    (0.30, (0.0, 0.06), (0.0, 0.06), (0.0, 0.05)),  # clean shaven
    (0.28, (0.08, 0.30), (0.08, 0.30), (0.06, 0.25)),  # shadow
    (0.16, (0.30, 0.60), (0.30, 0.60), (0.20, 0.55)),  # stubble
    (0.06, (0.60, 0.95), (0.0, 0.15), (0.0, 0.12)),  # moustache
    (0.08, (0.50, 0.90), (0.60, 0.95), (0.0, 0.20)),  # goatee
    (0.12, (0.65, 0.97), (0.75, 0.98), (0.65, 0.98)),  # full beard
)


@dataclass(frozen=True, eq=False)
class Hair:
    """Hair of one person.

    Attributes:
        brow, beard, scalp, lash: (V,) share of the skin that is covered, in [0, 1].
        colour: (V, 3) linear albedo of the hair that would grow at each vertex.
        length: of the hair on the scalp, decimetres.
    """

    brow: Array
    beard: Array
    scalp: Array
    lash: Array
    colour: Array
    length: float

    def cover(self) -> Array:
        """(V,) share of skin under any hair."""
        free = (1.0 - self.brow) * (1.0 - self.beard) * (1.0 - self.scalp) * (1.0 - self.lash)
        return np.asarray(1.0 - free)


def sample_hair(weights: RegionWeights, zones: FaceZones, person: Person, rng: np.random.Generator) -> Hair:
    """Hair of one person: colour by tone and age, a beard for some men, a hairline that recedes with age."""
    colour_rng, brow_rng, beard_rng, scalp_rng = rng.spawn(4)
    clumps = noise_bank(weights).draw(22.0, 4, rng)
    patches = noise_bank(weights).draw(6.0, 3, rng)
    scalp, length = _scalp(weights, zones, person, patches, scalp_rng)
    beard = _beard(zones, person, clumps, patches, beard_rng)
    return Hair(
        brow=_brow(weights, zones, person, clumps, brow_rng),
        beard=np.asarray(beard * (1.0 - scalp)),
        scalp=scalp,
        lash=zones.lash * rng.uniform(0.45, 0.9),
        colour=_colours(weights, person, clumps, patches, beard, colour_rng),
        length=length,
    )


def hair_colour(person: Person, rng: np.random.Generator) -> Array:
    """(3,) linear albedo of the hair: black for dark skin, anything for light skin, before it greys."""
    light = 1.0 - person.darkness
    shade = min(4.0, rng.exponential(0.25 + 2.2 * light**2))
    if light > 0.6 and rng.random() < 0.10:
        return np.asarray(RED * rng.uniform(0.6, 1.3))
    index = min(int(shade), 3)
    part = shade - index
    colour = (1.0 - part) * _NATURAL[index] + part * _NATURAL[index + 1]
    return np.asarray(colour * rng.uniform(0.8, 1.25))


def _colours(
    weights: RegionWeights,
    person: Person,
    clumps: Array,
    patches: Array,
    beard: Array,
    rng: np.random.Generator,
) -> Array:
    natural = hair_colour(person, rng)
    greyness = float(np.clip(rng.normal(1.5 * person.wear - 0.35, 0.25), 0.0, 1.0))
    dyed = person.male < 0.5 and rng.random() < 0.45
    on_head = 0.15 * greyness if dyed else greyness
    local = np.where(beard > 0.05, min(1.0, 1.2 * greyness), on_head)
    grey = np.clip(local + 0.12 * clumps[:, 1] * (local > 0.05), 0.0, 1.0)[:, None]
    colour = (1.0 - grey) * natural + grey * GREY * rng.uniform(0.7, 1.4)
    brow = weights.brow[:, None] * 0.6 * grey  # brows grey last, and are darker than blond hair
    colour = (1.0 - brow) * colour + brow * natural
    shade = 1.0 + 0.18 * clumps[:, 2] + 0.10 * patches[:, 1]
    return np.asarray(np.clip(colour * np.maximum(shade, 0.3)[:, None], 0.003, 0.6))


def _brow(
    weights: RegionWeights, zones: FaceZones, person: Person, clumps: Array, rng: np.random.Generator
) -> Array:
    """Two brows along the model's middle line, of one's own thickness, arch, tilt and density."""
    side, height, _ = zones.place.T
    inner, outer = rng.uniform(0.10, 0.15), rng.uniform(0.48, 0.56)
    along = np.clip((side - inner) / (outer - inner), 0.0, 1.0)
    arch = rng.normal(0.0, 0.012) + 0.012 * (1.0 - person.male)
    middle = zones.brow_middle + arch * np.sin(np.pi * along) + rng.normal(0.0, 0.012) * (along - 0.5)
    thick = rng.uniform(0.026, 0.042) + 0.012 * person.male
    taper = np.interp(along, [0.0, 0.15, 0.6, 1.0], [0.8, 1.0, 0.8, 0.3])
    across = np.abs(height - middle) / (thick * taper)
    ends = smoothstep(inner - 0.03, inner + 0.04, side) * smoothstep(outer + 0.02, outer - 0.06, side)
    density = rng.uniform(0.6, 0.97) * (1.0 - 0.25 * person.wear)
    if rng.random() < 0.1 * person.male:  # brows that meet
        ends = np.maximum(ends, 0.4 * smoothstep(0.16, 0.10, side) * (height < 7.60))
    cover = density * smoothstep(1.45, 0.45, across + 0.06 * clumps[:, 0]) * ends
    return np.asarray(np.clip(cover * (1.0 + 0.08 * clumps[:, 3]), 0.0, 0.97) * zones.front)


def _beard(
    zones: FaceZones, person: Person, clumps: Array, patches: Array, rng: np.random.Generator
) -> Array:
    """Nothing for women; for men one of the kinds in ``_BEARDS``."""
    if person.male < 0.5:
        return np.zeros(len(zones.place))
    kind = _BEARDS[int(rng.choice(len(_BEARDS), p=[beard[0] for beard in _BEARDS]))]
    moustache, chin, jaw = (float(rng.uniform(*cover)) for cover in kind[1:])
    centre = smoothstep(0.36, 0.24, zones.place[:, 0])
    lower = jaw + (chin - jaw) * centre * smoothstep(6.02, 6.20, zones.place[:, 1])
    cover = np.maximum(moustache * zones.moustache, lower * zones.jaw)
    # Sparser hair shows its clumps more; a full cover has none.
    uneven = 1.0 + (0.30 * clumps[:, 0] + 0.20 * patches[:, 0]) * (1.0 - cover)
    return np.asarray(np.clip(cover * uneven, 0.0, 0.98))


def _scalp(
    weights: RegionWeights, zones: FaceZones, person: Person, patches: Array, rng: np.random.Generator
) -> tuple[Array, float]:
    """Cover and length of the hair on the scalp."""
    side, height, _ = zones.place.T
    shift = rng.normal(0.0, 0.035)
    recession = max(0.0, rng.normal(0.30 * person.wear, 0.10)) * person.male
    temples = rng.uniform(0.0, 0.07) + 0.6 * recession
    peak = rng.uniform(0.0, 0.05) * (rng.random() < 0.3)
    edge = zones.hairline + shift - 0.5 * recession * smoothstep(7.5, 7.8, height)
    edge = edge - temples * np.exp(-(((side - 0.42) / 0.16) ** 2)) * smoothstep(7.6, 7.8, height)
    edge = edge + peak * np.exp(-((side / 0.09) ** 2)) + 0.012 * patches[:, 2]
    style = rng.random()
    bald = person.male > 0.5 and style < 0.12 + 0.30 * person.wear
    cover = rng.uniform(0.88, 0.99)
    length = float(rng.uniform(0.02, 0.10))
    if bald:
        cover = rng.choice([0.0, rng.uniform(0.15, 0.5), 0.9])
        length = 0.01 if cover < 0.6 else 0.03
        edge = edge - 0.6 * zones.crown
    soft = rng.uniform(0.03, 0.08)
    grown = smoothstep(-0.3 * soft, soft, edge) * (1.0 - weights.mouth_inside)
    return np.asarray(cover * grown), length
