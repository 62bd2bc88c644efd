"""Defects that are planted into renderers, to see that they are found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.color import linear_to_srgb
from sfsnet_dr.render.renderer import Budget, Capabilities, Image, Renderer
from sfsnet_dr.render.surface_maps import once, surface_maps
from sfsnet_dr.scene.lights import SceneLight, rotation_about
from sfsnet_dr.scene.subject import Subject

Array = npt.NDArray[np.float64]

#: Turns the light about this axis, oblique to every light of the matrix.
_AXIS = np.array([0.6, 0.64, 0.48])
_EXCHANGED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_FLATTEST = 0.02  # cosine below which nothing is divided by it

#: Renders a subject under a light, and may go wrong by a size in doing so.
Wrong = Callable[[Renderer, Subject, SceneLight, Budget, float], Image]


@dataclass(frozen=True)
class Defect:
    """A kind of defect.

    Attributes:
        kind: a word for records.
        words: what is wrong, at the size that has to be found.
        size: that size.
        unit: of the size; ``"1"`` for a share.
        render: renders with the defect.
        sized: whether smaller ones make sense.
        order: SH order of the renderers that can have it; None for any renderer.
    """

    kind: str
    words: str
    size: float
    unit: str
    render: Wrong
    sized: bool = True
    order: int | None = None


class Planted:
    """A renderer with a defect.

    Args:
        host: the renderer.
        defect: the kind of defect.
        size: its size, in the defect's unit.
    """

    def __init__(self, host: Renderer, defect: Defect, size: float) -> None:
        self.name, self.capabilities = host.name, host.capabilities
        self._host, self._defect, self._size = host, defect, size

    def render(self, subject: Subject, light: SceneLight, budget: Budget) -> Image:
        """The image with the defect."""
        return self._defect.render(self._host, subject, light, budget, self._size)


class Remembered:
    """A renderer that keeps its images, so that defects of the image cost no rendering.

    Args:
        host: the renderer.
    """

    def __init__(self, host: Renderer) -> None:
        self.name: str = host.name
        self.capabilities: Capabilities = host.capabilities
        self._host = host
        self._known: WeakKeyDictionary[Subject, dict[tuple[int, Budget], tuple[SceneLight, Image]]] = (
            WeakKeyDictionary()
        )

    def render(self, subject: Subject, light: SceneLight, budget: Budget) -> Image:
        """As the host's."""
        images = self._known.setdefault(subject, {})
        key = (id(light), budget)
        if key not in images:
            images[key] = (light, self._host.render(subject, light, budget))  # the light, to keep its id
        return images[key][1]


@once
def _with_albedo(subject: Subject, factor: float) -> Subject:
    return replace(subject, mesh=replace(subject.mesh, albedo=subject.mesh.albedo * factor))


@once
def _moved(subject: Subject, right: float) -> Subject:
    vertices = subject.mesh.vertices + np.array([right, 0.0, 0.0])
    return replace(subject, mesh=replace(subject.mesh, vertices=vertices))


@once
def _light_turned(light: SceneLight, degrees: float) -> SceneLight:
    return light.turned(rotation_about(_AXIS, degrees))


@once
def _light_exchanged(light: SceneLight) -> SceneLight:
    return light.turned(_EXCHANGED)


def _brighter(host: Renderer, subject: Subject, light: SceneLight, budget: Budget, size: float) -> Image:
    return host.render(_with_albedo(subject, 1 + size), light, budget)


def _turned(host: Renderer, subject: Subject, light: SceneLight, budget: Budget, size: float) -> Image:
    return host.render(subject, _light_turned(light, size), budget)


def _exchanged(host: Renderer, subject: Subject, light: SceneLight, budget: Budget, size: float) -> Image:
    return host.render(subject, _light_exchanged(light), budget)


def _shifted(host: Renderer, subject: Subject, light: SceneLight, budget: Budget, size: float) -> Image:
    pixel = 2.0 / subject.camera.size  # scene units at z = 0
    return host.render(_moved(subject, size * pixel), light, budget)


def _without_cosine(
    host: Renderer, subject: Subject, light: SceneLight, budget: Budget, size: float
) -> Image:
    """Divided by the cosine to the first lamp, or, without a lamp, to the brightest side of the map."""
    image = np.asarray(host.render(subject, light, budget), dtype=np.float64)
    normal = np.moveaxis(surface_maps(subject).normal[0].astype(np.float64), 0, -1)
    if light.directional:
        toward = light.directional[0][0]
    else:
        mean = light.coefficients(1).values[1:].sum(axis=1)[[1, 2, 0]]  # z, x, y to x, y, z
        toward = mean / max(float(np.linalg.norm(mean)), 1e-12)
    cosine = np.where(normal @ toward > _FLATTEST, normal @ toward, 1.0)
    return np.asarray(image * cosine[..., None] ** -size)


def _curved(host: Renderer, subject: Subject, light: SceneLight, budget: Budget, size: float) -> Image:
    """An image that is already linear light for its reader goes through the sRGB curve once more."""
    image = np.asarray(host.render(subject, light, budget), dtype=np.float64)
    return np.asarray((1 - size) * image + size * linear_to_srgb(np.maximum(image, 0.0)))


def _lower_order(host: Renderer, subject: Subject, light: SceneLight, budget: Budget, size: float) -> Image:
    from sfsnet_dr.render.registry import find_renderer

    image = np.asarray(host.render(subject, light, budget), dtype=np.float64)
    lower = find_renderer(host.name.replace("order4", "order2")).render(subject, light, budget)
    return np.asarray((1 - size) * image + size * lower)


DEFECTS: Final = (
    Defect("albedo", "albedo 1 % too bright", 0.01, "1", _brighter),
    Defect("light_direction", "the light turned by 1 degree", 1.0, "degree", _turned),
    Defect("swapped_axis", "the light's x and y axes exchanged", 1.0, "1", _exchanged, sized=False),
    Defect("half_pixel", "the picture moved by half a pixel", 0.5, "pixel", _shifted),
    Defect("missing_cosine", "no cosine between surface and light", 1.0, "1", _without_cosine),
    Defect("srgb_twice", "the sRGB curve applied once too often", 1.0, "1", _curved),
    Defect("order", "light of order 2 passed for order 4", 1.0, "1", _lower_order, order=4),
)
