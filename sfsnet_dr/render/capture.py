"""Ground-truth maps and light transport of a surface, in one pass over the pixels.

For every pixel: the mean unit normal, albedo, coverage and face mask under a box filter, and the linear
response to each SH basis light with visibility (Sloan, Kautz and Snyder 2002):

    T_k = mean over the pixel of  albedo / pi * integral of Y_k(w) V(x, w) max(n . w, 0) dw

so that under an environment with radiance coefficients l the image is sum_k T_k l_k, one bounce of light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.scene.jit import dr, mi
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene, albedo_at, camera_rays, face_at
from sfsnet_dr.sh.polynomials import sh_polynomials

Image = npt.NDArray[np.float32]

#: Additive recurrence of Roberts (2018) in four dimensions: powers of 1 / phi_4 with phi^5 = phi + 1.
_PHI = 1.1673039782614187
_STEPS = tuple(_PHI ** -(k + 1) for k in range(4))


#: Normal, albedo, hits, face hits and transport, each summed over samples.
Sums = tuple[mi.Normal3f, mi.Color3f, mi.Float, mi.Float, mi.ArrayXf]


@dataclass(frozen=True)
class Capture:
    """What a camera sees of a surface.

    Attributes:
        normal: (H, W, 3) unit vectors where anything was hit, else 0.
        albedo: (H, W, 3) linear, mean over the covered part of the pixel, else 0.
        coverage: (H, W) share of the pixel that the surface covers.
        mask: (H, W) 1 where the whole pixel is face skin, else 0.
        transport: (K, H, W, 3) response to the radiance basis lights; K = 9.
    """

    normal: Image
    albedo: Image
    coverage: Image
    mask: Image
    transport: Image


def capture(scene: SurfaceScene, samples: int, seed: int) -> Capture:
    """Render maps and transport of order 2.

    Each sample is one point of the pixel and one cosine-distributed direction from the surface there. The
    points follow a low-discrepancy sequence, shifted at random for each pixel, so that the estimate is
    unbiased and the result depends on ``seed`` alone.

    Args:
        scene: the surface and camera.
        samples: per pixel, at least 1.
        seed: any non-negative integer below 2^32.
    """
    if samples < 1:
        raise BadInput(f"samples: {samples} found, at least 1 is needed")
    size = scene.camera.size
    pixel = dr.arange(mi.UInt32, size * size)
    sums = _accumulate(scene, pixel, dr.opaque(mi.UInt32, samples), dr.opaque(mi.UInt32, seed & 0xFFFFFFFF))
    dr.eval(sums)
    normal, albedo, hits, face, transport = (_image(value, size) for value in sums)
    weight = np.maximum(hits, 1.0)
    length = np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    return Capture(
        normal=np.where(hits > 0, normal / length, 0.0).astype(np.float32),
        albedo=(albedo / weight).astype(np.float32),
        coverage=(hits[..., 0] / samples).astype(np.float32),
        mask=(face[..., 0] == samples).astype(np.float32),
        transport=np.moveaxis(transport.reshape(size, size, 9, 3) / samples, 2, 0).astype(np.float32),
    )


@dr.syntax
def _accumulate(scene: SurfaceScene, pixel: mi.UInt32, samples: mi.UInt32, seed: mi.UInt32) -> Sums:
    """Sums over the samples of each pixel: normal, albedo, hits, face hits, and the 27 transport values."""
    shift = _shifts(pixel, seed)
    sums = _zeros(dr.width(pixel))
    step = mi.UInt32(0)
    while step < samples:
        sums = _add(sums, _sample(scene, pixel, _points(shift, step)))
        step += 1
    return sums


def _sample(scene: SurfaceScene, pixel: mi.UInt32, point: list[mi.Float]) -> Sums:
    """One camera ray and one shadow ray for each pixel."""
    ray = camera_rays(scene.camera, pixel, mi.Point2f(point[0], point[1]))
    hit = scene.mi_scene.ray_intersect(ray, mi.RayFlags.All, coherent=True)
    found = hit.is_valid()
    front = found & (mi.Frame3f.cos_theta(hit.wi) > 0.0)  # as Mitsuba's one-sided diffuse surface
    toward = hit.to_world(mi.warp.square_to_cosine_hemisphere(mi.Point2f(point[2], point[3])))
    lit = front & ~scene.mi_scene.ray_test(hit.spawn_ray(toward), front)
    albedo = dr.select(found, albedo_at(hit, found), 0.0)
    reflected = dr.select(lit, albedo, 0.0)
    basis = sh_polynomials(toward.x, toward.y, toward.z, 2)
    response = [value * reflected[channel] for value in basis for channel in range(3)]
    return (
        dr.select(found, hit.sh_frame.n, 0.0),
        albedo,
        dr.select(found, mi.Float(1.0), 0.0),
        dr.select(found & face_at(hit, found), mi.Float(1.0), 0.0),
        mi.ArrayXf(response),
    )


def _zeros(width: int) -> Sums:
    return (
        dr.zeros(mi.Normal3f, width),
        dr.zeros(mi.Color3f, width),
        dr.zeros(mi.Float, width),
        dr.zeros(mi.Float, width),
        dr.zeros(mi.ArrayXf, (27, width)),
    )


def _add(left: Sums, right: Sums) -> Sums:
    a, b, c, d, e = (x + y for x, y in zip(left, right, strict=True))
    return a, b, c, d, e


def _points(shift: list[mi.Float64], step: mi.UInt32) -> list[mi.Float]:
    return [_fraction(offset + mi.Float64(step) * rate) for offset, rate in zip(shift, _STEPS, strict=True)]


def _shifts(pixel: mi.UInt32, seed: mi.UInt32) -> list[mi.Float64]:
    """Four uniform numbers for each pixel."""
    first, second = mi.sample_tea_32(pixel, seed, 6)
    third, fourth = mi.sample_tea_32(second, first, 6)
    return [mi.Float64(value) * 2.0**-32 for value in (first, second, third, fourth)]


def _fraction(value: mi.Float64) -> mi.Float:
    return dr.minimum(mi.Float(value - dr.floor(value)), 1.0 - 2.0**-24)


def _image(value: mi.ArrayXf, size: int) -> npt.NDArray[np.float64]:
    """(channels, pixels) to (H, W, channels)."""
    array = np.asarray(value, dtype=np.float64).reshape(-1, size * size)
    return np.moveaxis(array.reshape(-1, size, size), 0, -1)
