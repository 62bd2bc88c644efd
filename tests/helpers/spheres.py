"""Bundles of spheres whose light transport is known in closed form, to test on without a renderer."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.data.bundle import Bundle, BundleMeta, write_bundle
from sfsnet_dr.data.manifest import Entry, Manifest
from sfsnet_dr.scene.mesh import NO_REGION, Region
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.coefficients import Radiance
from sfsnet_dr.sh.kernel import band_of, clamped_cosine

SPEC = "spheres"


def sphere_bundle(seed: int, size: int = 16) -> Bundle:
    """A convex Lambertian ball, off the middle and of uneven colour.

    A convex body shadows nothing, so transport_k = albedo A_l / pi Y_k(n) and lamps_d = albedo / pi (n . w)+
    exactly.
    """
    rng = np.random.default_rng([seed, 99])
    centre, radius = rng.uniform(-0.2, 0.2, 2), rng.uniform(0.6, 0.75)
    x = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = (x[None, :] - centre[0]) / radius, (-x[:, None] - centre[1]) / radius
    x, y = np.broadcast_arrays(x, y)
    inside = (x**2 + y**2 < 0.97).astype(np.float32)
    normal = np.stack([x, y, np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))], -1) * inside[..., None]
    albedo = np.clip(rng.uniform(0.2, 0.6, 3) + 0.2 * np.sin(3 * x + y)[..., None], 0, 1) * inside[..., None]
    factor = (clamped_cosine(2) / np.pi)[band_of(2)]
    transport = albedo * np.moveaxis(sh_basis(normal, 2) * factor, -1, 0)[..., None]
    light = Radiance(rng.normal(size=(9, 3)))
    reference = np.einsum("khwc,kc->hwc", transport, light.values)
    directions = rng.normal(size=(2, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lamps = albedo / np.pi * np.maximum(np.einsum("hwc,dc->dhw", normal, directions), 0.0)[..., None]
    return Bundle(
        normal=as_float32(normal),
        albedo=as_float32(albedo),
        mask=inside,
        coverage=inside,
        regions=np.where(inside > 0, Region.SKIN, NO_REGION).astype(np.uint8),
        reference=as_float32(reference),
        variance=as_float32(np.full(normal.shape, 1e-9)),
        transport=as_float32(transport),
        gloss=np.zeros((0, size, size), np.float32),
        directional=as_float32(lamps),
        directions=directions,
        meta=BundleMeta(seed, "sphere", SPEC, light, {"spp": 0}),
    )


def as_float32(array: NDArray[np.floating]) -> NDArray[np.float32]:
    """A contiguous float32 copy."""
    return np.ascontiguousarray(array, np.float32)


def write_spheres(folder: Path, count: int, size: int = 16) -> Path:
    """A dataset of spheres with its manifest."""
    folder.mkdir(exist_ok=True)
    manifest = Manifest(folder, SPEC)
    for seed in range(count):
        path = folder / f"sphere_{seed:03d}.exr"
        write_bundle(path, sphere_bundle(seed, size))
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        manifest.append(Entry(path.name, seed, "sphere", SPEC, digest))
    return folder
