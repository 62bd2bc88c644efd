"""Ground-truth maps and light transport of a surface.

For every pixel: the mean unit normal, albedo, coverage, region and face mask under a box filter, and its
answer to any light, as ``render.transport`` defines it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_dilation

from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.core.visualize import on_white, png_bytes, show_encoded, show_linear, show_normals
from sfsnet_dr.render import transport
from sfsnet_dr.render.sobol import Points, Sampler, check_samples
from sfsnet_dr.scene.jit import dr, mi, upload_array
from sfsnet_dr.scene.mesh import FACE_REGIONS, NO_REGION
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene, camera_rays

Image = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.uint32]

#: Multiples of a number modulo a prime, to mix tiles by; up to 2^31 - 1 of them are distinct.
_MIXER, _PRIME = 1_327_217_885, (1 << 31) - 1

_TILE = 4  # neighbours in 4 x 4 pixels share a vector of rays, which then meet the same triangles


@dataclass(frozen=True)
class TransportOptions:
    """What is traced from each pixel.

    Attributes:
        order: of the transport.
        bounces: greatest number of surface points after the first one; 0 is light seen directly.
        paths: paths that leave by diffuse scattering where a camera ray hits, and as many by glossy
            reflection if the surface has gloss.
        sampler: see ``render.points``.
        gloss_order: of the mirror images; data sets and ``data.relight`` have that of the default.
    """

    order: int = 2
    bounces: int = 0
    paths: int = 1
    sampler: Sampler = "sobol"
    gloss_order: int = transport.GLOSS_ORDER


@dataclass(frozen=True)
class TransportMaps:
    """What a camera sees of a surface.

    Attributes:
        normal: (H, W, 3) unit vectors where anything was hit, else 0.
        albedo: (H, W, 3) linear, mean over the covered part of the pixel, else 0.
        coverage: (H, W) share of the pixel that the surface covers.
        mask: (H, W) 1 where the whole pixel is face skin, else 0.
        regions: (H, W) label of ``scene.mesh.Region`` that most of the pixel's samples hit, or ``NO_REGION``.
        transport: (K, H, W, 3) response to the radiance basis lights, without gloss seen directly.
        gloss: (G, H, W) their mirror images in the glossy lobes, 9 of order 2; (0, H, W) without lobes.
        directional: (D, H, W, 3) response to a light of irradiance 1 in each direction.
        rays: number of rays that were traced.
    """

    normal: Image
    albedo: Image
    coverage: Image
    mask: Image
    regions: npt.NDArray[np.uint8]
    transport: Image
    gloss: Image
    directional: Image
    rays: int

    def _repr_png_(self) -> bytes:
        """Normals, albedo and mask side by side, for notebooks."""
        mask = np.repeat(self.mask[..., None], 3, axis=-1)
        maps = (
            on_white(show_normals(self.normal), self.coverage),
            on_white(show_linear(self.albedo), self.coverage),
            show_encoded(mask),
        )
        return png_bytes(np.concatenate(maps, axis=1))


def render_aovs(
    scene: SurfaceScene,
    samples: int,
    seed: int,
    options: TransportOptions = TransportOptions(),
    directions: Array | None = None,
) -> TransportMaps:
    """Render maps and transport.

    Pixels more than one pixel away from all that a coarse look finds of the surface are taken as empty.

    Args:
        scene: the surface and camera.
        samples: camera rays of each pixel.
        seed: any non-negative integer.
        options: what else is traced.
        directions: (D, 3) unit vectors toward directional lights; None for none.

    Raises:
        InputError: for sample counts that the sampler cannot place, or directions that are no unit vectors.
    """
    toward = _checked(samples, options, directions)
    pixels = covered_pixels(scene)
    stage = _stage(scene, pixels, samples, seed, options, toward)
    sizes = stage.sizes()
    values = _to_images(transport.trace_transport(stage), pixels, scene.camera.size)
    parts = dict(zip(sizes, np.split(values, np.cumsum([*sizes.values()])[:-1]), strict=True))
    return TransportMaps(
        **_maps(np.moveaxis(parts["maps"], 0, -1).astype(np.float64) / samples),
        transport=_by_colour(parts["transport"]),
        gloss=np.ascontiguousarray(parts["gloss"]),
        directional=_by_colour(parts["directional"]),
        rays=int(parts["rays"].sum(dtype=np.float64)),
    )


def _stage(
    scene: SurfaceScene, pixels: Indices, samples: int, seed: int, options: TransportOptions, toward: Array
) -> transport.TransportKernel:
    pixel = upload_array(mi.UInt32, pixels)
    state = int(np.random.SeedSequence(seed).generate_state(1)[0])
    return transport.TransportKernel(
        scene,
        pixel,
        Points(options.sampler, pixel, dr.opaque(mi.UInt32, state)),
        samples=samples,
        paths=options.paths,
        lamps=toward,
        order=options.order,
        gloss_order=options.gloss_order,
        bounces=options.bounces,
    )


def _to_images(values: mi.ArrayXf, pixels: Indices, size: int) -> Image:
    """Values of pixels as images (values, H, W), 0 elsewhere.

    One by one: to read all at once is a kernel for each number of lanes.
    """
    dr.eval(values)
    images = np.zeros((len(values), size * size), dtype=np.float32)
    for image, value in zip(images, values, strict=True):
        image[pixels] = np.asarray(value)
    return images.reshape(len(values), size, size)


def covered_pixels(scene: SurfaceScene) -> Indices:
    """Numbers of the pixels in which, or next to which, one of 4 x 4 rays hits; neighbours together."""
    size = scene.camera.size
    shifts = (np.arange(4) + 0.5) / 4
    pixel = upload_array(mi.UInt32, _by_tiles(size))
    hits = mi.Bool(False)
    for x, y in itertools.product(shifts, shifts):
        ray = camera_rays(scene.camera, pixel, mi.Point2f(float(x), float(y)))
        hits |= scene.mi_scene.ray_test(ray, True, True)
    order = np.asarray(pixel)
    found = np.zeros(size * size, dtype=bool)
    found[order] = np.asarray(hits)
    near = binary_dilation(found.reshape(size, size), np.ones((3, 3), dtype=bool)).ravel()
    near[0] = True  # kernels need a lane, even where there is nothing to see
    return np.asarray(order[near[order]])


def _maps(values: Array) -> dict[str, Any]:
    """Normal, albedo, coverage, mask and regions from their means over samples, (H, W, 6 + regions)."""
    normal, albedo, share = values[..., :3], values[..., 3:6], values[..., 6:]
    coverage = share.sum(axis=-1)
    length = np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    on_face = share[..., list(FACE_REGIONS)].sum(axis=-1)
    return {
        "normal": (normal / length).astype(np.float32),
        "albedo": (albedo / np.maximum(coverage, 1e-12)[..., None]).astype(np.float32),
        "coverage": coverage.astype(np.float32),
        "mask": (on_face > 1.0 - 1e-6).astype(np.float32),
        "regions": np.where(coverage > 0, share.argmax(axis=-1), NO_REGION).astype(np.uint8),
    }


def _by_colour(values: Image) -> Image:
    """(3 K, H, W) to (K, H, W, 3)."""
    count, height, width = values.shape
    return np.ascontiguousarray(np.moveaxis(values.reshape(count // 3, 3, height, width), 1, -1))


def _by_tiles(size: int) -> Indices:
    """Numbers of all pixels, those of a tile together, and tiles in an order that mixes the image.

    Dr.Jit gives each thread one stretch of the pixels: mixed ones take equally long.
    """
    row, column = np.divmod(np.arange(size * size), size)
    across = -(-size // _TILE)
    tile = (row // _TILE) * across + column // _TILE
    mixed = tile * _MIXER % _PRIME
    return np.lexsort((column, row, mixed)).astype(np.uint32)


def _checked(samples: int, options: TransportOptions, directions: Array | None) -> Array:
    toward = np.zeros((0, 3)) if directions is None else np.asarray(directions, dtype=np.float64)
    check_shape("directions", toward, "D 3")
    check_samples("samples", samples)
    check_samples("samples times paths", samples * options.paths)
    if samples * options.paths < len(toward):
        raise InputError(
            f"samples times paths: {samples * options.paths} found, {len(toward)} lights need as many"
        )
    length = np.linalg.norm(toward, axis=1)
    if np.any(np.abs(length - 1.0) > 1e-5):
        raise InputError(f"directions: lengths {length.min():.6g} to {length.max():.6g} found, 1 allowed")
    return toward
