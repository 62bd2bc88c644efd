"""How a surface answers to basis lights and to directional lights: light paths from the pixels, traced once.

The image under an environment with radiance coefficients l and directional lights of irradiance e_d is

    sum_k T_k l_k  +  sum_k G_k l_k  +  sum_d D_d e_d

(Sloan, Kautz and Snyder 2002, with gloss apart). T, per colour, holds every path whose answer is coloured:
the diffuse response to the environment seen directly, and whatever arrives over further surface points, by
diffuse or glossy scattering at any of them. G, without colour, is the environment seen in the glossy lobes
directly. D is the full response, with hard shadows and interreflection, to a directional light of irradiance
1 on a surface that faces it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from sfsnet_dr.render.bsdf_sampling import Scatter, prepare_scatter
from sfsnet_dr.render.sobol import Points
from sfsnet_dr.scene.jit import dr, mi, upload_array
from sfsnet_dr.scene.mesh import Region
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene, camera_rays
from sfsnet_dr.sh.kernel import band_of
from sfsnet_dr.sh.polynomials import sh_polynomials

#: Order of G unless another is asked for.
GLOSS_ORDER: Final = 2

_UP = mi.ScalarVector3f(0.0, 0.0, 1.0)  # any direction, where one is needed and none is looked at

Hit: TypeAlias = mi.SurfaceInteraction3f


class TransportKernel:
    """What the kernel computes with. What varies between faces is in memory or opaque, so that a second
    face compiles nothing. (No dataclass: Dr.Jit would take it for a loop's state.)

    Args:
        scene: surface and camera.
        pixel: numbers of the pixels, one a lane.
        points: where to sample.
        samples: camera rays of each pixel.
        paths: paths that leave where one hits by diffuse scattering, and as many by glossy reflection if the
            surface has gloss.
        lamps: (D, 3) directions toward directional lights.
        order: of T.
        gloss_order: of G.
        bounces: greatest number of surface points after the first one.
    """

    def __init__(
        self,
        scene: SurfaceScene,
        pixel: mi.UInt32,
        points: Points,
        *,
        samples: int,
        paths: int,
        lamps: npt.NDArray[np.float64],
        order: int,
        gloss_order: int,
        bounces: int,
    ) -> None:
        prepare_scatter()
        self.scene, self.pixel, self.points = scene, pixel, points
        self.samples, self.paths = samples, paths
        self.sample_count, self.path_count = dr.opaque(mi.UInt32, samples), dr.opaque(mi.UInt32, paths)
        self.total = dr.opaque(mi.UInt32, samples * paths)
        self.lamps, self.lamp_count = (
            mi.Vector3f(*(upload_array(mi.Float, axis) for axis in lamps.T)),
            len(lamps),
        )
        self.order, self.gloss_order, self.bounces = order, gloss_order, bounces

    def sizes(self) -> dict[str, int]:
        """Numbers of values a pixel, in their order: T, G, D, and the sums over samples of maps and rays."""
        return {
            "transport": 3 * (self.order + 1) ** 2,
            "gloss": (self.gloss_order + 1) ** 2 if self.scene.gloss else 0,
            "directional": 3 * self.lamp_count,
            "maps": 6 + len(Region),
            "rays": 1,
        }


@dr.syntax
def trace_transport(stage: TransportKernel) -> mi.ArrayXf:
    """All values of all pixels, (values, lanes), in one symbolic loop over the samples."""
    # A block of its own: constants that an earlier block left alive would move in the code, and its kernel
    # would be another.
    dr.detail.new_scope(dr.backend_v(mi.Float))
    sums = dr.zeros(mi.ArrayXf, (sum(stage.sizes().values()), dr.width(stage.pixel)))
    step = mi.UInt32(0)
    while step < stage.sample_count:
        ray = camera_rays(stage.scene.camera, stage.pixel, stage.points.in_pixel(step, stage.samples))
        met = stage.scene.meet(ray, coherent=True)
        hit = stage.scene.hit_at(ray, met, met.is_valid())
        at = Scatter(stage.scene, hit, hit.is_valid())
        sums += mi.ArrayXf(_first_point(stage, hit, at))
        path = mi.UInt32(0)
        while path < stage.path_count:
            sums += mi.ArrayXf(_paths(stage, step * stage.path_count + path, hit, at))
            path += 1
        step += 1
    return sums


def _first_point(stage: TransportKernel, hit: Hit, at: Scatter) -> list[mi.Float]:
    """What a camera ray adds where it hits: T as if nothing shadowed it, D of light seen from there, maps."""
    share = 1.0 / mi.Float(stage.sample_count)
    normal, bands = dr.select(at.active, hit.sh_frame.n, _UP), at.unshadowed(stage.order)
    basis = zip(_basis(stage.order, normal), band_of(stage.order), strict=True)
    answer = [value * bands[band][c] * share for value, band in basis for c in range(3)]
    values, rays = [], mi.Float(1.0)
    for k in range(stage.lamp_count):
        value, traced = _lamp_value(stage, hit, at, mi.UInt32(k), at.active)
        values += [value[c] * share for c in range(3)]
        rays += traced
    return [*answer, *[mi.Float(0.0)] * stage.sizes()["gloss"], *values, *_maps(stage, hit), rays]


def _paths(stage: TransportKernel, index: mi.UInt32, hit: Hit, at: Scatter) -> list[mi.Float]:
    """What paths number ``index`` add: T, G, D over further surface points, and the number of rays.

    T of a point that nothing shadows is known (``_first_point``): where a first ray hits something, a diffuse
    path takes back what it would have brought. So points in the open have no noise.
    """
    count, random = stage.samples * stage.paths, stage.points.generator(index)
    lamp, share = _lamp_in_turn(stage, index)
    toward, weight = at.leave_diffuse(stage.points.direction(index, count))
    diffuse = _follow(stage, lamp, random, hit, toward, weight, at.active)
    first = dr.select(at.active, hit.to_world(toward), _UP)
    found = _times(stage.order, diffuse.away, dr.select(diffuse.direct, 0.0, diffuse.weight))
    lost = _times(stage.order, first, dr.select(diffuse.direct, 0.0, weight / mi.Float(stage.total)))
    answer = [a - b for a, b in zip(found, lost, strict=True)]
    gloss, collected, rays = [], diffuse.collected, diffuse.rays
    if stage.scene.gloss:
        toward, mirrored = at.leave_gloss(*stage.points.lobe(index, count))
        glossy = _follow(stage, lamp, random, hit, toward, mi.Color3f(mirrored), at.active)
        coloured = _times(stage.order, glossy.away, dr.select(glossy.direct, 0.0, glossy.weight))
        answer = [a + b for a, b in zip(answer, coloured, strict=True)]
        plain = dr.select(glossy.direct, glossy.weight.x, 0.0)  # the same in all colours
        gloss = [value * plain for value in _basis(stage.gloss_order, glossy.away)]
        collected, rays = collected + glossy.collected, rays + glossy.rays
    collected = collected * share
    given = [dr.select(lamp == k, collected[c], 0.0) for k in range(stage.lamp_count) for c in range(3)]
    return [*answer, *gloss, *given, *[mi.Float(0.0)] * stage.sizes()["maps"], rays]


@dataclass(frozen=True)
class _End:
    """How a path ended.

    Attributes:
        away: its last direction.
        weight: of the light from there; 0 if it did not escape.
        direct: whether it escaped from the first surface point.
        collected: what a directional light gave at the points after the first.
        rays: how many were traced.
    """

    away: mi.Vector3f
    weight: mi.Color3f
    direct: mi.Bool
    collected: mi.Color3f
    rays: mi.Float


@dr.syntax
def _follow(
    stage: TransportKernel,
    lamp: mi.UInt32,
    random: mi.PCG32,
    first: Hit,
    toward: mi.Vector3f,
    weight: mi.Color3f,
    active: mi.Bool,
) -> _End:
    """Trace a path until it escapes, is absorbed, or has met ``bounces`` further surface points.

    Each of those points, but the last one, looks at one directional light, ``lamp``.
    """
    weight = weight / mi.Float(stage.total)
    active = active & dr.any(weight > 0.0)
    ray = first.spawn_ray(first.to_world(toward))
    escaped, bounce = mi.Bool(False), mi.UInt32(0)
    rays, collected = mi.Float(0.0), mi.Color3f(0.0)
    while active:
        met = stage.scene.meet(ray, active)
        found = active & met.is_valid()
        escaped |= active & ~found
        rays += dr.select(active, 1.0, 0.0)
        bounce += 1
        active = found & (bounce <= stage.bounces)
        if active:  # at the end of most paths nothing is left to do for a whole vector of them
            hit = stage.scene.hit_at(ray, met, active)
            value, traced, factor, next_ray = _scatter(stage, hit, lamp, random, active)
            collected += weight * value
            rays += traced
            weight = weight * factor
            ray = next_ray
        active &= dr.any(weight > 0.0)
    away = dr.select(escaped, ray.d, _UP)
    return _End(away, dr.select(escaped, weight, 0.0), escaped & (bounce == 1), collected, rays)


def _scatter(
    stage: TransportKernel, hit: Hit, lamp: mi.UInt32, random: mi.PCG32, active: mi.Bool
) -> tuple[mi.Color3f, mi.Float, mi.Color3f, mi.Ray3f]:
    """At a further surface point: what its directional light gives and the rays that took, the share of light
    that goes on, 0 from behind, and the ray it comes along."""
    at = Scatter(stage.scene, hit, active)
    value, traced = mi.Color3f(0.0), mi.Float(0.0)
    if stage.lamp_count > 0:
        value, traced = _lamp_value(stage, hit, at, lamp, at.active)
    lobe, point = random.next_float32(), mi.Point2f(random.next_float32(), random.next_float32())
    toward, factor = at.leave(lobe, point)
    return value, traced, dr.select(at.active, factor, 0.0), hit.spawn_ray(hit.to_world(toward))


def _times(order: int, away: mi.Vector3f, weight: mi.Color3f) -> list[mi.Float]:
    return [value * weight[c] for value in _basis(order, away) for c in range(3)]


def _basis(order: int, away: mi.Vector3f) -> list[mi.Float]:
    return sh_polynomials(away.x, away.y, away.z, order)


def _lamp_in_turn(stage: TransportKernel, index: mi.UInt32) -> tuple[mi.UInt32, mi.Float]:
    """The light that a path looks at, and the inverse share of the paths that look at the same.

    Each light has its stretch of the paths: consecutive points are as even as the whole set.
    """
    count = max(stage.lamp_count, 1)
    lamp = index * count // stage.total
    first, after = ((k * stage.total + count - 1) // count for k in (lamp, lamp + 1))
    return lamp, mi.Float(stage.total) / mi.Float(after - first)


def _lamp_value(
    stage: TransportKernel, hit: Hit, at: Scatter, lamp: mi.UInt32, active: mi.Bool
) -> tuple[mi.Color3f, mi.Float]:
    """Radiance reflected from a directional light of irradiance 1, and the number of rays it took."""
    toward = dr.gather(mi.Vector3f, stage.lamps, lamp, active)
    local = hit.to_local(toward)
    value = at.diffuse(local) + at.gloss(local)
    facing = active & dr.any(value > 0.0)
    hidden = stage.scene.mi_scene.ray_test(hit.spawn_ray(toward), facing)
    return dr.select(facing & ~hidden, value, 0.0), dr.select(facing, mi.Float(1.0), 0.0)


def _maps(stage: TransportKernel, hit: Hit) -> list[mi.Float]:
    """Normal, albedo, and a hit of the region."""
    found = hit.is_valid()
    normal = dr.select(found, hit.sh_frame.n, 0.0)
    albedo = dr.select(found, stage.scene.albedo_at(hit, found), 0.0)
    region = stage.scene.region_at(hit, found)
    hits = [dr.select(found & (region == int(label)), mi.Float(1.0), 0.0) for label in Region]
    return [*normal, *albedo, *hits]
