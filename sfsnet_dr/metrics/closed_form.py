"""Images of the sphere and the plane that no renderer made: formulas, integrated over each pixel.

Nothing is shared with the renderers but the projection of environment maps: rays meet the ideal sphere, a
directional light shades by Lambert's law or by a series of Legendre polynomials, and a map by SciPy's
spherical harmonics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.spec import SceneSpec
from sfsnet_dr.sh.coefficients import Radiance
from sfsnet_dr.sh.kernel import MAX_ORDER, clamped_cosine
from sfsnet_dr.sh.projection import equirect_solid_angles, project_equirect

Array = npt.NDArray[np.float64]

#: Shapes that have a closed form. Both are convex, so that no light bounces or is shadowed.
SHAPES: Final = ("sphere", "plane")

_RADIUS: Final = 0.9
#: The sphere's mesh lies inside it: by up to 2.7e-4 of the radius with 96 rings (1 - cos(pi / 192) each way).
_FACETS: Final = 3e-4
#: Radians of a facet. Where light falls flatter, shadow rays of one facet meet the next.
_FACET_ANGLE: Final = np.pi / 96
#: Pixels by which an edge may lie elsewhere than the formula has it, as few samples find it.
_EDGE: Final = 0.01
_ROUNDING: Final = 2e-5  # relative; a path's product in float32
_INSIDE, _AT_EDGE = 4, 16  # samples along a pixel's edge, in pixels that are covered wholly and partly


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """An exact image, and what a correct renderer of the scene may differ by.

    Attributes:
        image: (H, W, 3).
        allowance: (H, W, 3), at least 0. Causes: the mesh's facets; edges that are
            known to 0.01 pixel; float32; in SH models that shade a
            pixel's mean normal, the difference of that to the mean shading; for a map under all orders,
            what may lie above the order that is computed, by Cauchy and Schwarz.
    """

    image: Array
    allowance: Array


def has_closed_form(spec: SceneSpec) -> bool:
    """Whether a scene is one of those."""
    return spec.shape in SHAPES and not spec.has_gloss


def closed_form(spec: SceneSpec, light: Light, order: int | None, *, deferred: bool) -> ClosedForm:
    """The image of a sphere or plane as its camera sees it, all light counted or that to an SH order.

    Args:
        spec: the scene.
        light: what falls on it.
        order: highest band of the light, unclamped as in ``f_render``; None for all light.
        deferred: whether the renderer may shade a pixel's mean normal once.

    Raises:
        InputError: for another scene.
    """
    if not has_closed_form(spec):
        raise InputError(
            f"{spec.name}: shape {spec.shape!r} found, {', '.join(SHAPES)} without gloss allowed"
        )
    albedo = np.asarray(spec.albedo or (0.5, 0.5, 0.5))
    shade = _Shade(light, order)
    image, mean_normal, coverage = _pixels(spec, shade, _RADIUS)
    allowance = _ROUNDING * np.abs(image) + 1e-7
    if spec.shape == "sphere":
        smaller, _, _ = _pixels(spec, shade, _RADIUS * (1 - _FACETS))
        partly = ((coverage > 0) & (coverage < 1))[..., None]
        allowance = allowance + 2 * np.abs(image - smaller) + _EDGE * partly * np.abs(shade(mean_normal))
        if order is None:
            allowance = allowance + _at_terminator(light, mean_normal)
    if deferred:
        allowance = allowance + np.abs(coverage[..., None] * shade(mean_normal) - image)
    return ClosedForm(albedo * image, albedo * (allowance + coverage[..., None] * shade.beyond))


class _Shade:
    """Shading (..., 3) of a white convex surface by its normals (..., 3)."""

    def __init__(self, light: Light, order: int | None) -> None:
        self.directional, self.order = light.directional, order
        self.radiance: Radiance | None = None
        if light.environment is not None:
            self.radiance = project_equirect(light.environment, MAX_ORDER if order is None else order)
        self.beyond: Array = _beyond(light, self.radiance) if order is None else np.zeros(3)

    def __call__(self, normals: Array) -> Array:
        total = np.zeros(normals.shape)
        if self.radiance is not None:
            total += by_harmonics(normals, self.radiance)
        for direction, irradiance in self.directional:
            cosine = normals @ direction
            share = np.maximum(cosine, 0.0) if self.order is None else by_legendre(cosine, self.order)
            total += share[..., None] * irradiance / np.pi
        return total


def by_legendre(cosine: Array, order: int) -> Array:
    """The clamped cosine to an SH order: sum over l of (2 l + 1) / 4 pi A_l P_l, by the addition theorem."""
    bands = np.arange(order + 1)
    series = (2 * bands + 1) / (4 * np.pi) * clamped_cosine(order)
    return np.asarray(np.polynomial.legendre.legval(cosine, series))


def by_harmonics(normals: Array, radiance: Radiance) -> Array:
    """Shading (..., 3) by radiance coefficients, with the real harmonics taken from SciPy's complex ones."""
    from scipy.special import sph_harm_y

    polar = np.arccos(np.clip(normals[..., 2], -1.0, 1.0))
    azimuth = np.arctan2(normals[..., 1], normals[..., 0])
    factors = clamped_cosine(radiance.order) / np.pi
    total, k = np.zeros(normals.shape), 0
    for band in range(radiance.order + 1):
        for m in range(band + 1):
            if factors[band] != 0:
                value = sph_harm_y(band, m, polar, azimuth) * (-1) ** m * (np.sqrt(2) if m else 1)
                total += factors[band] * value.real[..., None] * radiance.values[k]
                if m:
                    total += factors[band] * value.imag[..., None] * radiance.values[k + 1]
            k += 2 if m else 1
    return total


def _beyond(light: Light, radiance: Radiance | None) -> Array:
    """Greatest shading (3,) that the map's bands above the computed order can add anywhere."""
    if light.environment is None or radiance is None:
        return np.zeros(3)
    power = (equirect_solid_angles(*MAP_SIZE)[..., None] * light.environment**2).sum(axis=(0, 1))
    left = np.maximum(power - (radiance.values**2).sum(axis=0), 0.0)
    bands = np.arange(MAX_ORDER + 1)
    kernel = 2 * np.pi / 3 - ((2 * bands + 1) / (4 * np.pi) * clamped_cosine(MAX_ORDER) ** 2).sum()
    return np.asarray(np.sqrt(left * kernel) / np.pi)


def _at_terminator(light: Light, normals: Array) -> Array:
    """Light (H, W, 3) that shadow rays may lose where it falls flatter than a facet is wide."""
    lost = np.zeros(normals.shape)
    for direction, irradiance in light.directional:
        flat = np.abs(normals @ direction) < 2 * _FACET_ANGLE
        lost += (flat * _FACET_ANGLE)[..., None] * irradiance / np.pi
    return lost


def _pixels(spec: SceneSpec, shade: _Shade, radius: float) -> tuple[Array, Array, Array]:
    """Mean shading (H, W, 3), mean unit normal (H, W, 3) and coverage (H, W) of every pixel."""
    size = spec.camera.size
    row, column = (index.ravel() for index in np.indices((size, size)))
    normals, hit = _normals(spec, radius, row, column, _INSIDE + 1, corners=True)
    partly = hit.any(axis=1) & ~hit.all(axis=1)
    image, mean, coverage = np.zeros((size * size, 3)), np.zeros((size * size, 3)), np.zeros(size * size)
    for chosen, steps in ((hit.all(axis=1), _INSIDE), (partly, _AT_EDGE)):
        normals, hit = _normals(spec, radius, row[chosen], column[chosen], steps)
        coverage[chosen] = hit.mean(axis=1)
        image[chosen] = (shade(normals) * hit[..., None]).mean(axis=1)
        mean[chosen] = (normals * hit[..., None]).mean(axis=1)
    mean /= np.maximum(np.linalg.norm(mean, axis=-1, keepdims=True), 1e-12)
    return image.reshape(size, size, 3), mean.reshape(size, size, 3), coverage.reshape(size, size)


def _normals(
    spec: SceneSpec,
    radius: float,
    row: npt.NDArray[np.int64],
    column: npt.NDArray[np.int64],
    steps: int,
    *,
    corners: bool = False,
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Normals (P, steps^2, 3) at points of pixels, and whether each meets the surface (P, steps^2).

    The points are midpoints of a grid, or with ``corners`` reach from one edge of the pixel to the other.
    """
    at = np.linspace(0, 1, steps) if corners else (np.arange(steps) + 0.5) / steps
    down, across = (offset.ravel() for offset in np.meshgrid(at, at, indexing="ij"))
    size, distance = spec.camera.size, spec.camera.distance
    x = 2 * (column[:, None] + across) / size - 1
    y = 1 - 2 * (row[:, None] + down) / size
    if spec.shape == "plane":
        normals = np.zeros((*x.shape, 3))
        normals[..., 2] = 1.0
        return normals, np.ones(x.shape, dtype=bool)
    toward = np.stack([x, y, np.full_like(x, -distance)], axis=-1)
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    along = -distance * toward[..., 2]  # of the point of the ray that is nearest to the centre
    inside = along**2 - distance**2 + radius**2
    point = (along - np.sqrt(np.maximum(inside, 0.0)))[..., None] * toward
    point[..., 2] += distance
    return point / np.linalg.norm(point, axis=-1, keepdims=True), inside > 0
