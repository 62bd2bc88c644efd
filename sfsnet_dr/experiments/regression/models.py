"""Which physics a renderer has, and the path-traced picture that it should arrive at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sfsnet_dr.metrics.equivalence import Estimate
from sfsnet_dr.render.path_tracer import path_trace
from sfsnet_dr.render.renderers.base import Capabilities
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.subject import Subject
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.projection import equirect_directions, project_equirect

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Model:
    """Light transport with cast shadows, up to some limits.

    Attributes:
        bounces: surface points after the first; -1 has no limit.
        gloss: whether the subject's gloss counts.
        order: SH order to which the light is known; None for all of it.
    """

    bounces: int
    gloss: bool = False
    order: int | None = None

    @property
    def name(self) -> str:
        """A word for file channels and tables."""
        depth = {-1: "path", 0: "direct"}.get(self.bounces, f"bounces{self.bounces}")
        light = "" if self.order is None else f"order{self.order}-"
        return f"{light}{depth}{'-gloss' if self.gloss else ''}"


def model_of(capabilities: Capabilities, subject: Subject) -> Model:
    """The model of a renderer that knows cast shadows, on a subject."""
    gloss = capabilities.gloss and subject.spec.has_gloss
    return Model(capabilities.bounces, gloss, capabilities.order)


def trace_model(subject: Subject, light: Light, model: Model, samples: int, seed: int) -> Estimate:
    """The model's picture by path tracing; its variance comes from the samples.

    Light of few SH bands is negative in places. It is then rendered in two parts, the positive and the
    negative, each with all the samples: nothing here is shared with the renderers that weigh transport.
    """
    if model.order is None:
        return _traced(subject, light, model, samples, seed)
    positive, negative = truncate_light(light, model.order)
    first = _traced(subject, positive, model, samples, seed)
    if negative is None:
        return first
    second = _traced(subject, negative, model, samples, seed + 1)
    return Estimate(first.mean - second.mean, first.variance + second.variance, first.freedom)


def truncate_light(light: Light, order: int) -> tuple[Light, Light | None]:
    """The light to an SH order as maps: its positive part and, where it has one, its negative part."""
    wanted = light.coefficients(order).values
    basis = sh_basis(equirect_directions(*MAP_SIZE), order)
    given = wanted
    for _ in range(2):  # texels are interpolated, which weakens band l by about l^2 x 0.03 %
        found = project_equirect(basis @ given, order).values
        given = given + wanted - found
    values = basis @ given
    negative = np.maximum(-values, 0.0)
    lower = Light(light.name, negative) if negative.max() > 0 else None
    return Light(light.name, np.maximum(values, 0.0)), lower


def _traced(subject: Subject, light: Light, model: Model, samples: int, seed: int) -> Estimate:
    lit = light.environment is not None
    scene = SurfaceScene(subject.mesh, subject.camera, light.directional, environment=lit, gloss=model.gloss)
    if light.environment is not None:
        scene.set_environment(light.environment)
    depth = -1 if model.bounces < 0 else model.bounces + 2
    found = path_trace(scene, samples, seed, depth)
    return Estimate(found.mean, found.variance, samples - 1.0)
