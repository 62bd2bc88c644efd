"""What the SH renderers know of a subject before any light is chosen: maps and transport, traced once.

Nothing here depends on the light, so it is kept as long as its subject lives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Concatenate, Final, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from sfsnet_dr.render.capture import CaptureOptions, capture
from sfsnet_dr.scene.lights import MAP_ORDER, SceneLight
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


def once(make: Callable[Concatenate[K, P], V]) -> Callable[Concatenate[K, P], V]:
    """Remember results for as long as the first argument lives; the others have to be hashable."""
    known: WeakKeyDictionary[K, dict[tuple[object, ...], V]] = WeakKeyDictionary()

    @wraps(make)
    def remembered(key: K, /, *more: P.args, **named: P.kwargs) -> V:
        results, call = known.setdefault(key, {}), (*more, *sorted(named.items()))
        if call not in results:
            results[call] = make(key, *more, **named)
        return results[call]

    return remembered


@once
def surface_maps(subject: Subject, seed: int = 0) -> SurfaceMaps:
    """Normals and covered albedo; ``sampling.transport`` of the subject's scene says with how many rays."""
    rays = max(MAP_RAYS, subject.spec.sampling.transport)
    seen = capture(SurfaceScene(subject.mesh, subject.camera), rays, seed, CaptureOptions(order=0))
    return SurfaceMaps(_planes(seen.normal), _planes(seen.albedo * seen.coverage[..., None]))


@once
def direct_transport(subject: Subject, seed: int = 0) -> Planes:
    """(25, H, W, 3) answer to the radiance basis lights of order 4, cast shadows included."""
    return _transport(subject, seed, bounces=0)


@once
def bounced_transport(subject: Subject, seed: int = 0) -> Planes:
    """As ``direct_transport``, with light that met one further point of the surface."""
    return _transport(subject, seed, bounces=1)


@once
def radiance(light: SceneLight) -> Radiance:
    """All the light's radiance coefficients of order 4, directional lights smeared into them."""
    return light.coefficients(TRANSPORT_ORDER)


def _transport(subject: Subject, seed: int, bounces: int) -> Planes:
    sampling = subject.spec.sampling
    options = CaptureOptions(order=TRANSPORT_ORDER, bounces=bounces, paths=sampling.paths)
    scene = SurfaceScene(subject.mesh, subject.camera)
    return capture(scene, sampling.transport, seed, options).transport


def _planes(image: Planes) -> Planes:
    return np.ascontiguousarray(np.moveaxis(image, -1, 0)[None], dtype=np.float32)
