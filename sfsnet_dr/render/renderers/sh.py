"""SH shading models as renderers, and the maps and transport that they need of a subject.

Names: ``torch-order2`` shades normals; ``numpy-order4-visibility`` weighs light transport, which knows cast
shadows; ``-bounce`` adds light that met one further point. Gloss is left out. Images are not clamped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any, Concatenate, Final, Literal, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt
import torch

from sfsnet_dr.render import shading_drjit, shading_numpy, shading_torch
from sfsnet_dr.render.aovs import TransportOptions, render_aovs
from sfsnet_dr.render.renderers.base import Budget, Capabilities, Image
from sfsnet_dr.render.transport_shading import DrjitTransport, relight_transport
from sfsnet_dr.scene.lights.light import MAP_ORDER, Light
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.subject import Subject
from sfsnet_dr.sh.coefficients import Radiance

Planes = npt.NDArray[np.float32]
K = TypeVar("K")
P = ParamSpec("P")
V = TypeVar("V")

#: Least number of camera rays a pixel for the maps: a silhouette's coverage is then right to about 1 %.
MAP_RAYS: Final = 64

#: Highest order of the transport; lower ones are its first coefficients.
TRANSPORT_ORDER: Final = MAP_ORDER


@dataclass(frozen=True, eq=False)
class SurfaceMaps:
    """The two images that SH shading starts from.

    Attributes:
        normal: (1, 3, H, W) mean unit normal, 0 where the surface is not seen.
        albedo: (1, 3, H, W) linear, times the share of the pixel that the surface covers.
    """

    normal: Planes
    albedo: Planes


def memoize(make: Callable[Concatenate[K, P], V]) -> Callable[Concatenate[K, P], V]:
    """Remember results for as long as the first argument lives; the others have to be hashable."""
    known: WeakKeyDictionary[K, dict[tuple[object, ...], V]] = WeakKeyDictionary()

    @wraps(make)
    def remembered(key: K, /, *more: P.args, **named: P.kwargs) -> V:
        results, call = known.setdefault(key, {}), (*more, *sorted(named.items()))
        if call not in results:
            results[call] = make(key, *more, **named)
        return results[call]

    return remembered


@memoize
def surface_maps(subject: Subject, seed: int = 0) -> SurfaceMaps:
    """Normals and covered albedo; ``sampling.spp`` of the subject's scene says with how many rays."""
    rays = max(MAP_RAYS, subject.spec.sampling.spp)
    seen = render_aovs(SurfaceScene(subject.mesh, subject.camera), rays, seed, TransportOptions(order=0))
    return SurfaceMaps(_planes(seen.normal), _planes(seen.albedo * seen.coverage[..., None]))


@memoize
def direct_transport(subject: Subject, seed: int = 0) -> Planes:
    """(25, H, W, 3) answer to the radiance basis lights of order 4, cast shadows included."""
    return _transport(subject, seed, bounces=0)


@memoize
def bounced_transport(subject: Subject, seed: int = 0) -> Planes:
    """As ``direct_transport``, with light that met one further point of the surface."""
    return _transport(subject, seed, bounces=1)


@memoize
def light_radiance(light: Light) -> Radiance:
    """All the light's radiance coefficients of order 4, directional lights smeared into them."""
    return light.coefficients(TRANSPORT_ORDER)


def _transport(subject: Subject, seed: int, bounces: int) -> Planes:
    sampling = subject.spec.sampling
    options = TransportOptions(order=TRANSPORT_ORDER, bounces=bounces, paths=sampling.paths_per_hit)
    scene = SurfaceScene(subject.mesh, subject.camera)
    return render_aovs(scene, sampling.spp, seed, options).transport


def _planes(image: Planes) -> Planes:
    return np.ascontiguousarray(np.moveaxis(image, -1, 0)[None], dtype=np.float32)


Array = npt.NDArray[np.float64]
Backend = Literal["numpy", "torch", "drjit"]
Kind = Literal["visibility", "bounce"]


class ShadingRenderer:
    """``f_render`` on a subject's normals and albedo; nothing shadows anything.

    Args:
        backend: the implementation.
        order: of the light, 0 to 4.
    """

    def __init__(self, backend: Backend, order: int) -> None:
        self.name = f"{backend}-order{order}"
        self.capabilities = Capabilities(visibility=False, order=order)
        self._form, self._order = _SHADING[backend], order

    def render(self, subject: Subject, light: Light, budget: Budget) -> Image:
        """An image (H, W, 3): float64 by NumPy, else float32."""
        maps = surface_maps(subject, budget.seed)
        shading = light_radiance(light).truncate(self._order).to_shading().flat()[None]
        return np.moveaxis(self._form(maps.normal, maps.albedo, shading)[0], 0, -1)


class TransportRenderer:
    """A subject's light transport, weighed by the light's coefficients.

    Args:
        backend: the implementation.
        order: of the light, 0 to 4.
        kind: whether the transport holds direct light with its shadows, or one bounce too.
    """

    def __init__(self, backend: Literal["numpy", "drjit"], order: int, kind: Kind) -> None:
        self.name = f"{backend}-order{order}-{kind}"
        self.capabilities = Capabilities(visibility=True, bounces=int(kind == "bounce"), order=order)
        self._answers, self._weigh = _TRANSPORT[backend][kind], _WEIGH[backend]
        self._order = order

    def render(self, subject: Subject, light: Light, budget: Budget) -> Image:
        """An image (H, W, 3): float64 by NumPy, float32 by Dr.Jit."""
        return self._weigh(
            self._answers(subject, budget.seed), light_radiance(light).truncate(self._order).values
        )


def _by_numpy(normal: Planes, albedo: Planes, shading: Array) -> Image:
    return shading_numpy.f_render(normal, albedo, shading)


def _by_torch(normal: Planes, albedo: Planes, shading: Array) -> Image:
    return _tensors(shading_torch.f_render, normal, albedo, shading)


def _by_drjit(normal: Planes, albedo: Planes, shading: Array) -> Image:
    return _tensors(shading_drjit.f_render, normal, albedo, shading)


def _tensors(form: Callable[..., torch.Tensor], *arrays: npt.NDArray[np.floating]) -> Image:
    return form(*(torch.from_numpy(array.astype(np.float32, copy=False)) for array in arrays)).numpy()


_SHADING: Final[dict[str, Callable[[Planes, Planes, Array], Image]]] = {
    "numpy": _by_numpy,
    "torch": _by_torch,
    "drjit": _by_drjit,
}
_TRANSPORT: Final[dict[str, dict[str, Callable[[Subject, int], Any]]]] = {
    "numpy": {"visibility": direct_transport, "bounce": bounced_transport},
    "drjit": {
        "visibility": memoize(lambda subject, seed: DrjitTransport(direct_transport(subject, seed))),
        "bounce": memoize(lambda subject, seed: DrjitTransport(bounced_transport(subject, seed))),
    },
}
_WEIGH: Final[dict[str, Callable[[Any, Array], Image]]] = {
    "numpy": lambda transport, light: relight_transport(transport[: len(light)], Radiance(light)),
    "drjit": lambda transport, light: transport.relight(light),
}
