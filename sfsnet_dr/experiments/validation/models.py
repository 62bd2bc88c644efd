"""The shading models: order 0 to 4, with visibility, with one bounce, with gloss.

A model knows a subject by what is captured of it once: mean normals and albedo, or its light transport. Under
any light an image is then one Dr.Jit kernel, the one that is timed. Nothing is clamped.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from sfsnet_dr.render.aovs import TransportMaps, TransportOptions, render_aovs
from sfsnet_dr.render.shading_drjit_reference import render_planes
from sfsnet_dr.render.transport_shading import (
    DrjitTransport,
    ResponseWeights,
    drjit_weights,
    relight_responses,
    weigh_responses,
)
from sfsnet_dr.scene.jit import dr, mi, upload_array
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.spec import FACE_SHAPES
from sfsnet_dr.scene.subject import Subject
from sfsnet_dr.sh.coefficients import Radiance

Image = npt.NDArray[np.float64]
Kind = Literal["analytic", "visibility", "bounce", "gloss"]

#: Rays a pixel for normals and albedo, when nothing else is captured.
MAP_RAYS: Final = 64

_ORDER = 4  # of all transport
_GLOSS_TERMS = 9


@dataclass(frozen=True)
class ShadingModel:
    """One model.

    Attributes:
        name: for people.
        kind: what it knows beside the order.
        order: of the light.
    """

    name: str
    kind: Kind
    order: int

    @property
    def key(self) -> str:
        """The name in records: ``order2``, ``order4_visibility``."""
        return self.name.replace(" + ", "_").replace(" ", "")

    @property
    def bytes_per_pixel(self) -> int:
        """Memory that a kernel must move for a pixel in float32: what it reads and 3 values it writes."""
        terms = (self.order + 1) ** 2
        read = {
            "analytic": 6,
            "visibility": 3 * terms,
            "bounce": 3 * terms,
            "gloss": 3 * terms + _GLOSS_TERMS,
        }
        return 4 * (read[self.kind] + 3)


def shading_models(gloss: bool) -> tuple[ShadingModel, ...]:
    """All models, from the cheapest; the last one only for subjects with gloss."""
    analytic = tuple(ShadingModel(f"order {order}", "analytic", order) for order in range(5))
    shadowed = tuple(ShadingModel(f"order {order} + visibility", "visibility", order) for order in (2, 4))
    bounced = tuple(ShadingModel(f"order {order} + bounce", "bounce", order) for order in (2, 4))
    return (
        *analytic,
        *shadowed,
        *bounced,
        *((ShadingModel("order 4 + gloss", "gloss", 4),) if gloss else ()),
    )


@dataclass(frozen=True, eq=False)
class ModelInputs:
    """What the models know of a subject.

    Attributes:
        maps: normals, albedo, coverage, mask.
        mask: (H, W) pixels that are counted: whole ones, of face skin if it is a face.
        transport: by kind, two captures with different seeds; the models use their mean.
        seconds: time of the captures by kind, compiled and warm, once a subject.
    """

    maps: TransportMaps
    mask: Image
    transport: dict[Kind, tuple[TransportMaps, TransportMaps]]
    seconds: dict[Kind, float]
    _planes: dict[str, Any] = field(default_factory=dict)

    def inputs(self, model: ShadingModel) -> tuple[Any, ...]:
        """Dr.Jit arrays that the model's kernel reads."""
        if model.kind not in self._planes:
            made = (
                _surface_planes(self.maps)
                if model.kind == "analytic"
                else _answers(self.transport[model.kind])
            )
            self._planes[model.kind] = made
        planes: tuple[Any, ...] = self._planes[model.kind]
        if model.kind == "analytic":
            return planes
        return (planes[0][: (model.order + 1) ** 2], planes[1])

    def image(self, model: ShadingModel, light: Light) -> Image:
        """(H, W, 3) of a model under a light."""
        values = shading_kernel(model)(
            *self.inputs(model), *light_weights(model, light.coefficients(model.order))
        )
        dr.eval(values)
        return np.asarray(values, dtype=np.float64).T.reshape(self.maps.normal.shape)

    def noise(self, model: ShadingModel, light: Light) -> float:
        """Mean squared noise of a model's image under a light, from its two captures."""
        if model.kind == "analytic":
            return 0.0
        coefficients = light.coefficients(model.order).values
        weights = ResponseWeights(coefficients, np.zeros((0, 3)))
        first, second = (
            relight_responses(seen.transport[: len(coefficients)], seen.gloss, seen.directional, weights)
            for seen in self.transport[model.kind]
        )
        difference = ((first - second) / 2) ** 2 * self.mask[..., None]
        return float(difference.sum() / (3 * self.mask.sum()))


def capture_inputs(subject: Subject, seed: int, models: tuple[ShadingModel, ...]) -> ModelInputs:
    """Capture all that models need; compiles with few rays first, so that the times are warm ones."""
    sampling = subject.spec.sampling
    plain = SurfaceScene(subject.mesh, subject.camera)
    maps, took = _timed(plain, MAP_RAYS, seed, TransportOptions(order=0))
    transport: dict[Kind, tuple[TransportMaps, TransportMaps]] = {}
    seconds: dict[Kind, float] = {"analytic": took}
    for kind in dict.fromkeys(model.kind for model in models if model.kind != "analytic"):
        scene = SurfaceScene(subject.mesh, subject.camera, gloss=True) if kind == "gloss" else plain
        options = TransportOptions(
            order=_ORDER, bounces=int(kind != "visibility"), paths=sampling.paths_per_hit
        )
        half = max(1, sampling.spp // 2)
        (first, one), (second, two) = (_timed(scene, half, 2 * seed + k, options) for k in (1, 2))
        transport[kind], seconds[kind] = (first, second), one + two
    whole = maps.mask if subject.spec.shape in FACE_SHAPES else maps.coverage >= 1.0
    return ModelInputs(maps, np.asarray(whole, dtype=np.float64), transport, seconds)


def shading_kernel(model: ShadingModel) -> Callable[..., mi.Color3f]:
    """The function that makes a model's image of its inputs and weights; not evaluated."""
    return _shade if model.kind == "analytic" else weigh_responses


def light_weights(model: ShadingModel, radiance: Radiance) -> tuple[Any, ...]:
    """Coefficients of the model's order as the kernel takes them: they change without a new compilation."""
    if model.kind == "analytic":
        return ([dr.opaque(mi.Float, float(x)) for x in radiance.to_shading().flat()],)
    return (drjit_weights(radiance.values),)


def _shade(normal: mi.Vector3f, albedo: mi.Color3f, light: list[mi.Float]) -> mi.Color3f:
    return mi.Color3f(*render_planes([*normal], [*albedo], light))


def _surface_planes(maps: TransportMaps) -> tuple[Any, ...]:
    return mi.Vector3f(*_planes(maps.normal)), mi.Color3f(*_planes(maps.albedo * maps.coverage[..., None]))


def _answers(captures: tuple[TransportMaps, TransportMaps]) -> tuple[Any, ...]:
    means = [(getattr(captures[0], k) + getattr(captures[1], k)) / 2 for k in ("transport", "gloss")]
    held = DrjitTransport(*means)
    return held.responses, held.gloss


def _planes(image: npt.NDArray[np.float32]) -> list[mi.Float]:
    return [upload_array(mi.Float, image[..., c]) for c in range(image.shape[-1])]


def _timed(
    scene: SurfaceScene, samples: int, seed: int, options: TransportOptions
) -> tuple[TransportMaps, float]:
    render_aovs(scene, 1, seed, options)
    begin = time.perf_counter()
    return render_aovs(scene, samples, seed, options), time.perf_counter() - begin
