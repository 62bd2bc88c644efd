"""How wrong a shading model can be on a scene: under the worst light, and under usual ones.

The lights are all mixtures of the basis lights of order 4, negative ones included; those that are negative
nowhere; every direction of an icosphere; and a prior of natural, studio and hard light. Whatever is found is
measured once more with the path tracer of the references, which shares no code with the capture's paths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.experiments.worst_light.responses import (
    ORDER,
    Effort,
    PreparedResponses,
    Prior,
    Responses,
    Target,
    basis_responses,
    directional_responses,
    draw_prior,
    light_batches,
    prior_errors,
    select_target,
)
from sfsnet_dr.experiments.worst_light.search import WorstLightResult, worst_non_negative, worst_signed
from sfsnet_dr.metrics.bootstrap import Interval, bootstrap_interval
from sfsnet_dr.metrics.noise_free import RelativeRmse, relative_rmse
from sfsnet_dr.render.path_tracer import path_trace
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.sampling import LARGEST_ANGLE
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.subject import Subject
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.icosphere import icosphere
from sfsnet_dr.sh.projection import equirect_directions, project_equirect

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.floating]
Step = Callable[[], None]

#: Orders of the model in tables; order 3 equals 2, for the clamped cosine has no third band.
ORDERS: Final = (0, 1, 2, 4)

#: An image counts as no dimmer than this share of the brightest that a light of its energy gives.
DIMMEST: Final = 0.05

#: Lights drawn from the prior.
LIGHTS: Final = 400


@dataclass(frozen=True, eq=False)
class Shown:
    """A light that was found, and images under it.

    Attributes:
        sky: (64, 128) radiance of the light, or None for a directional one.
        image: (H, W, 3) traced; of a light of one colour, that colour three times.
        model: (H, W, 3).
        error: relative RMS error by the answers that it was found with.
        traced: the same by the path tracer.
    """

    sky: Array | None
    image: Image
    model: Image
    error: RelativeRmse
    traced: RelativeRmse


@dataclass(frozen=True, eq=False)
class Directional:
    """Errors under one directional light, for every direction.

    Attributes:
        of_own: (N,) relative to the image under the same light; NaN beyond 85 degrees from the viewer's.
        of_mean: (N,) relative to the root mean square of all images.
        pooled: root mean square error over all directions, of the root mean square of all images.
    """

    of_own: Array
    of_mean: Array
    pooled: float


@dataclass(frozen=True, eq=False)
class OrderResult:
    """What was found for the model of an order.

    Attributes:
        signed: the worst light of order 4.
        non_negative: the worst that is negative nowhere.
        directional: errors by direction.
        prior: (L,) relative errors under the lights of the prior.
    """

    signed: WorstLightResult
    non_negative: WorstLightResult
    directional: Directional
    prior: Array


@dataclass(frozen=True, eq=False)
class WorstLight:
    """The study of one scene.

    Attributes:
        name: the scene's.
        order: of the model whose lights are shown.
        mask: (H, W) pixels that were measured on.
        directions: (N, 3).
        kinds: (L,) of the lights of the prior.
        by_order: results of every order.
        signed: images under the worst light of order 4.
        non_negative: under the worst that is negative nowhere.
        directional: under the worst directional one.
        direction: (3,) of that, up to 85 degrees from the viewer's.
        noise: of an answer to basis lights, RMS, relative to the brightest.
    """

    name: str
    order: int
    mask: npt.NDArray[np.bool_]
    directions: Array
    kinds: tuple[str, ...]
    by_order: dict[int, OrderResult]
    signed: Shown
    non_negative: Shown
    directional: Shown
    direction: Array
    noise: float

    @property
    def own(self) -> OrderResult:
        """Results of the order that is shown."""
        return self.by_order[self.order]

    def prior_interval(self, order: int, statistic: Callable[[Array], float]) -> Interval:
        """95 % interval of a statistic over the lights of the prior."""
        return bootstrap_interval(self.by_order[order].prior, statistic)


def study_steps(effort: Effort) -> int:
    """How often ``study_worst_light`` reports."""
    return 2 + light_batches(len(icosphere(effort.level))) + 3


def study_worst_light(
    subject: Subject,
    effort: Effort,
    *,
    order: int = 2,
    lights: int = LIGHTS,
    seed: int = 0,
    step: Step = lambda: None,
) -> WorstLight:
    """Find the worst lights of a subject.

    Args:
        subject: what is looked at.
        effort: what is traced.
        order: of the model whose worst lights are shown; 0, 1, 2 or 4.
        lights: drawn from the prior.
        seed: of all random numbers.
        step: called ``steps(effort)`` times.
    """
    of, directions = select_target(subject, effort), icosphere(effort.level)
    basis = basis_responses(of, seed)
    step()
    lamps = directional_responses(of, directions, seed, step)
    prior = draw_prior(directions, lights, seed)
    step()
    forms, hard = basis.forms(), lamps.forms()
    by_order = {n: _by_order(forms, hard, prior, directions, n) for n in sorted({*ORDERS, order})}
    own = by_order[order]
    worst = int(np.nanargmax(own.directional.of_own))
    shown = []
    for light in (own.signed, own.non_negative):
        shown.append(_shown_mixture(of, basis, light, order, seed))
        step()
    hard_shown = _shown_direction(of, lamps, directions, worst, order, seed)
    step()
    return WorstLight(
        name=subject.spec.name,
        order=order,
        mask=basis.mask,
        directions=directions,
        kinds=prior.kinds,
        by_order=by_order,
        signed=shown[0],
        non_negative=shown[1],
        directional=hard_shown,
        direction=directions[worst],
        noise=_noise(basis, forms),
    )


def directional_errors(forms: PreparedResponses, directions: Array, order: int) -> Directional:
    """Errors of the model of an order under each of N directional lights, over all colours."""
    off = np.maximum(np.einsum("cnn->n", forms.error(order)), 0.0)
    power = np.einsum("cnn->n", forms.truth)
    front = directions[:, 2] >= np.cos(np.radians(LARGEST_ANGLE))
    with np.errstate(invalid="ignore", divide="ignore"):
        own = np.where(front & (power > 0), np.sqrt(off / np.maximum(power, 1e-300)), np.nan)
    return Directional(own, np.sqrt(off / power.mean()), float(np.sqrt(off.mean() / power.mean())))


def _by_order(
    forms: PreparedResponses, hard: PreparedResponses, prior: Prior, directions: Array, order: int
) -> OrderResult:
    return OrderResult(
        signed=_worst_colour(forms, order, worst_signed),
        non_negative=_worst_colour(forms, order, worst_non_negative),
        directional=directional_errors(hard, directions, order),
        prior=prior_errors(hard, prior, order),
    )


def _worst_colour(
    forms: PreparedResponses, order: int, search: Callable[[Array, Array, float], WorstLightResult]
) -> WorstLightResult:
    """The worst light of one colour: colours do not mix, so that no coloured light is worse."""
    errors = forms.error(order)
    found = [replace(search(errors[c], forms.truth[c], DIMMEST), colour=c) for c in range(3)]
    return max(found, key=lambda one: one.error)


def _shown_mixture(of: Target, basis: Responses, light: WorstLightResult, order: int, seed: int) -> Shown:
    """Images under a light of one colour; errors count a dim image as the search does."""
    colour = light.colour
    weights = np.zeros((len(light.light), 3))
    weights[:, colour] = light.light
    sky = sh_basis(equirect_directions(*MAP_SIZE), ORDER) @ light.light
    counted = min(1.0, light.brightness / DIMMEST)
    mask = basis.mask.astype(np.float64)
    first, second, model = (image[..., colour : colour + 1] for image in basis.images(weights, order))
    error = _scaled(relative_rmse(model, first, second, mask), counted)
    traced = _traced_sky(of, sky, seed)
    # The map's own coefficients: its texels are bilinear, which dims band 4 by half a per cent.
    lit = project_equirect(np.repeat(sky[..., None], 3, axis=-1), ORDER).values
    _, _, same = basis.images(lit, order)
    c = slice(colour, colour + 1)
    confirmed = _scaled(relative_rmse(same[..., c], traced[0][..., c], traced[1][..., c], mask), counted)
    mean = (first + second) / 2
    return Shown(sky, np.repeat(mean, 3, axis=-1), np.repeat(model, 3, axis=-1), error, confirmed)


def _traced_sky(of: Target, sky: Array, seed: int) -> list[Image]:
    """Two path-traced images under a map that may be negative: its positive part less its negative."""
    parts = [np.maximum(sky, 0.0), np.maximum(-sky, 0.0)]
    images: list[Image] = []
    for k in range(2):
        total = np.zeros((of.scene.camera.size, of.scene.camera.size, 3))
        for sign, part in zip((1, -1), parts, strict=True):
            if part.max() > 1e-3 * parts[0].max():
                of.scene.set_environment(part[..., None])
                paths = of.subject.spec.sampling.reference_spp
                total += sign * path_trace(of.scene, paths, 4 * seed + 2 * k + (sign < 0)).mean
        images.append(total)
    return images


def _shown_direction(
    of: Target, lamps: Responses, directions: Array, index: int, order: int, seed: int
) -> Shown:
    weights = np.zeros((len(directions), 3))
    weights[index] = 1.0
    mask = lamps.mask.astype(np.float64)
    first, second, model = lamps.images(weights, order)
    light = [(directions[index], np.ones(3))]
    scene = SurfaceScene(of.subject.mesh, of.scene.camera, light, gloss=of.scene.gloss)
    paths = of.subject.spec.sampling.reference_spp
    traced = [path_trace(scene, paths, 4 * seed + k).mean for k in range(2)]
    return Shown(
        None,
        np.where(lamps.mask[..., None], (traced[0] + traced[1]) / 2, 0.0),
        model,
        relative_rmse(model, first, second, mask),
        relative_rmse(model, traced[0], traced[1], mask),
    )


def _scaled(error: RelativeRmse, factor: float) -> RelativeRmse:
    return RelativeRmse(error.value * factor, error.low * factor, error.high * factor, error.bias_squared)


def _noise(basis: Responses, forms: PreparedResponses) -> float:
    return float(
        max(
            np.sqrt(np.linalg.eigvalsh(noise)[-1] / np.linalg.eigvalsh(truth)[-1])
            for noise, truth in zip(basis.noise(), forms.truth, strict=True)
        )
    )
