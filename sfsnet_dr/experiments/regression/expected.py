"""What each renderer should show, by its own model: a formula where there is one, else a stored reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter, minimum_filter

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.experiments.regression.config import KnownDifference
from sfsnet_dr.experiments.regression.models import Model, model_of
from sfsnet_dr.experiments.regression.references import Maps, References
from sfsnet_dr.metrics.closed_form import closed_form, has_closed_form
from sfsnet_dr.metrics.equivalence import Estimate, exact_estimate
from sfsnet_dr.render.renderers.base import Capabilities
from sfsnet_dr.render.shading_numpy import MAX_ORDER, shading, unit
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.subject import Subject

Array = npt.NDArray[np.float64]

#: Error of a float32 sum of 25 terms or of a path's product, relative to the brightest pixel: terms of either
#: sign may cancel.
ROUNDING: Final = 1e-5

_STEP = 1e-3  # radians, of the numerical derivative of shading by the normal


@dataclass(frozen=True, eq=False)
class Expected:
    """What an image is held to.

    Attributes:
        kind: ``formula``, ``stored maps`` or ``path tracing``.
        estimate: the picture.
        allowance: (H, W, 3), systematic differences that are no defect; ``kind`` says where they come from.
        words: what a row compares, for people.
        subject, light: what it shows.
        says: what the renderer accounts for.
    """

    kind: str
    estimate: Estimate
    allowance: Array
    words: str
    subject: Subject
    light: Light
    says: Capabilities


class ExpectedImages:
    """The truths of one subject under one light; many renderers share a few.

    Args:
        subject, light: what is rendered.
        references: what is stored.
    """

    def __init__(self, subject: Subject, light: Light, references: References) -> None:
        self.subject, self.light, self.references = subject, light, references
        self._known: dict[Capabilities, Expected] = {}

    def of(self, capabilities: Capabilities) -> Expected:
        """``expected_image`` a renderer with these capabilities."""
        if capabilities not in self._known:
            self._known[capabilities] = expected_image(
                capabilities, self.subject, self.light, self.references
            )
        return self._known[capabilities]


def expected_image(
    capabilities: Capabilities, subject: Subject, light: Light, references: References
) -> Expected:
    """The truth of a renderer on a subject under a light.

    Raises:
        InputError: if there is none, or a reference is missing or belongs to something else.
    """
    shades, shown = not capabilities.visibility, (subject, light, capabilities)
    if shades and (capabilities.bounces or (capabilities.gloss and subject.spec.has_gloss)):
        raise InputError(f"{subject.spec.name}: no truth for bounces or gloss without cast shadows")
    if has_closed_form(subject.spec):
        found = closed_form(subject.spec, light, capabilities.order, deferred=shades)
        return Expected(
            "formula", exact_estimate(found.image), found.allowance, _formula_words(capabilities), *shown
        )
    if shades:
        estimate = shade_maps(references.maps(subject), light, capabilities.order)
        words = f"NumPy float64 {_order_words(capabilities)} shading of stored maps"
        return Expected("stored maps", estimate, _rounding(estimate), words, *shown)
    model = model_of(capabilities, subject)
    estimate = references.picture(subject, light, model)
    words = f"stored path tracing: {_model_words(model)}"
    return Expected("path tracing", estimate, _rounding(estimate), words, *shown)


def allow_known_differences(truth: Expected, known: Sequence[KnownDifference]) -> Expected:
    """A truth that allows for what is known of a renderer, too."""
    if not known:
        return truth
    mean = truth.estimate.mean
    around = (3, 3, 1)
    contrast = maximum_filter(mean, around) - minimum_filter(mean, around)
    allowance = truth.allowance + sum(k.relative * np.abs(mean) + k.edges * contrast for k in known)
    words = "; ".join([truth.words, *(f"allowed: {_known_words(k)}" for k in known)])
    return replace(truth, allowance=allowance, words=words)


def shade_maps(maps: Maps, light: Light, order: int | None) -> Estimate:
    """The NumPy form of a shading model on stored maps, with the noise of the maps carried through."""
    middle = shade_expected(maps.normal, light, order)
    slope = np.zeros_like(middle)
    for tangent in _tangents(maps.normal):
        slope += ((shade_expected(maps.normal + _STEP * tangent, light, order) - middle) / _STEP) ** 2
    from_normals = maps.albedo**2 * slope * maps.normal_deviation[..., None] ** 2
    variance = from_normals + middle**2 * maps.albedo_deviation**2
    return Estimate(maps.albedo * middle, variance)


def shade_expected(normal: Array, light: Light, order: int | None) -> Array:
    """Shading (H, W, 3) to an order; for all light, lamps by Lambert's law and the map to order 8."""
    coefficients = light.environment_coefficients(MAX_ORDER) if order is None else light.coefficients(order)
    flat = coefficients.to_shading().flat()[None]
    total = np.moveaxis(shading(np.moveaxis(normal, -1, 0)[None], flat)[0], 0, -1)
    if order is None:
        for direction, irradiance in light.directional:
            total = total + np.maximum(unit(normal) @ direction, 0.0)[..., None] * irradiance / np.pi
    return np.asarray(total)


def _tangents(normal: Array) -> tuple[Array, Array]:
    axis = np.where(np.abs(normal[..., :1]) < 0.6, np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))
    first = unit(np.cross(normal, axis))
    return first, np.cross(normal, first)


def _rounding(estimate: Estimate) -> Array:
    return np.full_like(estimate.mean, ROUNDING * np.abs(estimate.mean).max())


def _order_words(capabilities: Capabilities) -> str:
    return "full-light" if capabilities.order is None else f"order-{capabilities.order}"


def _formula_words(capabilities: Capabilities) -> str:
    return f"formula, no noise: {_order_words(capabilities)} Lambertian shading of the ideal surface"


def _known_words(known: KnownDifference) -> str:
    sizes = []
    if known.relative:
        sizes.append(f"{100 * known.relative:g} %")
    if known.edges:
        sizes.append(f"contours {known.edges:g} pixels apart")
    return f"{' and '.join(sizes)} ({known.cause})"


def _model_words(model: Model) -> str:
    depth = {-1: "all bounces", 0: "direct light", 1: "one bounce"}.get(
        model.bounces, f"{model.bounces} bounces"
    )
    light = "" if model.order is None else f", light of order {model.order}"
    return f"{depth}{light}{', with gloss' if model.gloss else ''}"
