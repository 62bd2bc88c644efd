"""Lights as a scene has them, as mixtures of directional lights whose answers are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.equirect import MAP_SIZE
from sfsnet_dr.scene.light_sources import LARGEST_ANGLE, sample_scene_light
from sfsnet_dr.scene.light_spec import LightSpec
from sfsnet_dr.scene.lights import SceneLight
from sfsnet_dr.sh.projection import equirect_directions, equirect_solid_angles
from sfsnet_dr.study.light_answers import Forms

Array = npt.NDArray[np.float64]

#: Every kind of light that needs no files, as data sets have them, with as many of ``sh.priors``.
PRIOR: Final = LightSpec(hdr=0.0, lobes=0.25)


@dataclass(frozen=True, eq=False)
class Prior:
    """Lights drawn from the prior.

    Attributes:
        kinds: (L,) names.
        weights: (L, N, 3) irradiance from each of N directions.
    """

    kinds: tuple[str, ...]
    weights: Array


def draw_prior(directions: Array, count: int, seed: int, spec: LightSpec = PRIOR) -> Prior:
    """Draw lights.

    Lamps and suns come from the given directions exactly, at most 85 degrees from the viewer's; those of
    ``sample_scene_light`` from elsewhere are soft. Maps are gathered at the directions.

    Args:
        directions: (N, 3) unit vectors, evenly spread.
        count: how many lights.
        seed: of the lights; equal seeds give equal lights for every scene.
        spec: kinds and weights.
    """
    rng = np.random.default_rng([seed, 7])
    front = directions[directions[:, 2] >= np.cos(np.radians(LARGEST_ANGLE))]
    nearest = nearest_direction(equirect_directions(*MAP_SIZE), directions)
    lights = [sample_scene_light(rng, spec, front) for _ in range(count)]
    weights = [gathered(light, directions, nearest) for light in lights]
    return Prior(tuple(light.name for light in lights), np.array(weights))


def gathered(light: SceneLight, directions: Array, nearest: npt.NDArray[np.intp]) -> Array:
    """(N, 3) irradiance from each direction; all light of a map's texel comes from the nearest one.

    Args:
        light: the light.
        directions: (N, 3).
        nearest: (H, W) of the map, as of ``nearest_direction``.
    """
    weights = np.zeros((len(directions), 3))
    if light.environment is not None:
        power = light.environment * equirect_solid_angles(*MAP_SIZE)[..., None]
        np.add.at(weights, nearest.ravel(), power.reshape(-1, 3))
    for toward, power in light.directional:
        weights[np.argmax(directions @ toward)] += power
    return weights


def nearest_direction(vectors: Array, directions: Array) -> npt.NDArray[np.intp]:
    """(...,) index of the direction nearest to each unit vector (..., 3)."""
    return np.asarray(np.argmax(vectors @ directions.T, axis=-1))


def prior_errors(forms: Forms, prior: Prior, order: int) -> Array:
    """(L,) relative RMS error of the model of an order under each light, over all colours."""
    error, truth = forms.error(order), forms.truth
    off = np.einsum("lnc,cnm,lmc->l", prior.weights, error, prior.weights, optimize=True)
    power = np.einsum("lnc,cnm,lmc->l", prior.weights, truth, prior.weights, optimize=True)
    return np.asarray(np.sqrt(np.maximum(off, 0.0) / power))


def mean(errors: Array) -> float:
    """Mean error over lights (L,)."""
    return float(errors.mean())


def p95(errors: Array) -> float:
    """95th percentile of errors over lights (L,)."""
    return float(np.quantile(errors, 0.95))
