"""What a surface point does with light: the BSDFs of ``SurfaceScene`` in a form that is quick to trace with.

Mitsuba's ``blendbsdf`` of two ``roughplastic`` answers one question at a time and does the work of both lobes
each time; the path tracer of the references uses it. Here a point's values are computed once, and a sample
picks one kind of scattering and needs the density of that one only. Same values: a test holds them together.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.jit import dr, mi
from sfsnet_dr.scene.mitsuba_scene import DULL_ALPHA, SHINY_ALPHA, SurfaceScene, lobe
from sfsnet_dr.sh.kernel import clamped_cosine

Array = npt.NDArray[np.float64]

_WHITE = {"type": "rgb", "value": [1.0, 1.0, 1.0]}

#: Nodes of Mitsuba's table of the transmittance of a rough interface over the cosine.
_NODES = 64

_LEAST_SHARE = 0.05  # of the samples that go into the glossy lobes, so that no weight exceeds 20


class Scatter:
    """A surface point under the camera or at the end of a path.

    Directions are in the hit's shading frame, point away from the surface, and values contain the cosine.

    Args:
        scene: the surface.
        hit: a point of it, and with ``hit.wi`` the direction that it is seen from.
        active: lanes that matter; there, too, nothing is reflected if the point is seen from behind.
    """

    def __init__(self, scene: SurfaceScene, hit: mi.SurfaceInteraction3f, active: mi.Bool) -> None:
        self.active = active & (mi.Frame3f.cos_theta(hit.wi) > 0.0)
        self.albedo = dr.select(self.active, scene.albedo_at(hit, self.active), 0.0)
        self._gloss, self._wi = scene.gloss, hit.wi
        if self._gloss:
            mix = scene.roughness_mix_at(hit, self.active)
            self._mix = dr.select(self.active, dr.clip(mix, 0.0, 1.0), 0.0)
            self._entering = dr.select(self.active, _transmittance(self._wi.z), 0.0)

    def diffuse(self, toward: mi.Vector3f) -> mi.Color3f:
        """Diffuse scattering toward a direction, times its cosine."""
        cosine = dr.select(toward.z > 0.0, toward.z, 0.0)
        return self._body(toward) * (cosine / dr.pi)

    def unshadowed(self, order: int) -> list[mi.Color3f]:
        """Response, by diffuse scattering alone, of a point that nothing shadows: one colour for each band.

        The response to Y_lm is that of band l times Y_lm of the normal (Ramamoorthi and Hanrahan 2001).
        """
        if not self._gloss:
            return [self.albedo * float(value) for value in clamped_cosine(order) / np.pi]
        kernels = [self._entering * mi.Vector2f(*map(float, pair)) for pair in _kernels()[: order + 1]]
        return [self.albedo * dr.lerp(pair.x, pair.y, self._mix) for pair in kernels]

    def gloss(self, toward: mi.Vector3f) -> mi.Float:
        """Glossy reflection toward a direction, times its cosine; the same for every colour."""
        if not self._gloss:
            return mi.Float(0.0)
        half = dr.normalize(toward + self._wi)
        fresnel = mi.fresnel(dr.dot(self._wi, half), _ior())[0]
        lobes = [self._microfacets(alpha, half, toward) for alpha in (DULL_ALPHA, SHINY_ALPHA)]
        value = fresnel * dr.lerp(*lobes, self._mix) / (4.0 * self._wi.z)
        return dr.select(self.active & (toward.z > 0.0), value, 0.0)

    def leave_diffuse(self, sample: mi.Point2f) -> tuple[mi.Vector3f, mi.Color3f]:
        """A cosine-distributed direction, and diffuse scattering over its density."""
        toward = mi.warp.square_to_cosine_hemisphere(sample)
        return toward, self._body(toward)

    def leave_gloss(self, lobe: mi.Float, sample: mi.Point2f) -> tuple[mi.Vector3f, mi.Float]:
        """A direction in one of the glossy lobes (Heitz 2018), and glossy reflection over its density."""
        alpha = dr.select(lobe < self._mix, mi.Float(SHINY_ALPHA), mi.Float(DULL_ALPHA))
        facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, sample_visible=True)
        normal, _ = facets.sample(self._wi, sample)
        toward = mi.reflect(self._wi, normal)
        weight = mi.fresnel(dr.dot(self._wi, normal), _ior())[0] * facets.smith_g1(toward, normal)
        return toward, dr.select(self.active & (toward.z > 0.0), weight, 0.0)

    def leave(self, lobe: mi.Float, sample: mi.Point2f) -> tuple[mi.Vector3f, mi.Color3f]:
        """A direction by one kind of scattering, picked by what each reflects, and that over its density."""
        toward, weight = self.leave_diffuse(sample)
        if not self._gloss:
            return toward, weight
        mirrored = mi.fresnel(self._wi.z, _ior())[0]
        body = (weight.x + weight.y + weight.z) / 3.0
        share = dr.maximum(mirrored / (mirrored + body + 1e-6), _LEAST_SHARE)
        by_gloss = lobe < share
        shiny, mirror = self.leave_gloss(lobe / share, sample)
        return (
            dr.select(by_gloss, shiny, toward),
            dr.select(by_gloss, mi.Color3f(mirror / share), weight / (1.0 - share)),
        )

    def _body(self, toward: mi.Vector3f) -> mi.Color3f:
        """Diffuse scattering times pi."""
        if not self._gloss:
            return self.albedo
        through = self._entering * _transmittance(toward.z)
        lit = self.active & (toward.z > 0.0)
        return self.albedo * dr.select(lit, dr.lerp(through.x, through.y, self._mix), 0.0)

    def _microfacets(self, alpha: float, half: mi.Vector3f, toward: mi.Vector3f) -> mi.Float:
        facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, sample_visible=True)
        return facets.eval(half) * facets.G(self._wi, toward, half)


def prepare() -> None:
    """Read off Mitsuba's BSDF what is needed for gloss. Has to happen once, outside all symbolic loops."""
    _ior()
    _kernels()


@cache
def _ior() -> float:
    """Relative index of refraction of the interface, as Mitsuba has it: against air, not against vacuum."""
    return float(np.ravel(mi.traverse(mi.load_dict(lobe(DULL_ALPHA, _WHITE)))["eta"])[0])


@cache
def _table() -> mi.Float:
    """Square root of (diffuse scattering times pi, of a white body) over the cosine, in memory.

    Scattering is a product of equal functions of both cosines. Mitsuba has them as lines between 64 nodes;
    each node has the values of the dull and of the shiny lobe there, and those of the next node.
    """
    cosine = np.concatenate([[0.5 / (_NODES - 1)], np.arange(1, _NODES) / (_NODES - 1)])
    lines = [_root(alpha, cosine) for alpha in (DULL_ALPHA, SHINY_ALPHA)]
    nodes = np.stack([np.concatenate([[2 * line[0] - line[1]], line[1:]]) for line in lines], axis=1)
    table = mi.Float(np.concatenate([nodes[:-1], nodes[1:]], axis=1).ravel().astype(np.float32))
    dr.eval(table)
    return table


@cache
def _kernels() -> Array:
    """(9, 2) zonal coefficients of (table times clamped cosine over pi), of the dull and the shiny lobe.

    Exact for the table's straight lines: Gauss and Legendre's rule with 8 points on each of them.
    """
    edges = np.arange(_NODES) / (_NODES - 1)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    cosine = edges[:-1, None] + (nodes + 1) / 2 * np.diff(edges)[:, None]
    table = np.asarray(_table(), dtype=np.float64).reshape(-1, 4)
    lines = table[:, None, :2] + (nodes[:, None] + 1) / 2 * (table[:, 2:] - table[:, :2])[:, None]
    weight = weights / 2 * np.diff(edges)[:, None] * 2.0 * cosine
    legendre = np.stack([np.polynomial.Legendre.basis(band)(cosine) for band in range(9)])
    return np.asarray(np.einsum("ij,lij,ija->la", weight, legendre, lines))


def _root(alpha: float, cosine: Array) -> Array:
    """The function at cosines, read off Mitsuba's BSDF where both directions have the same one."""
    bsdf, hit = mi.load_dict(lobe(alpha, _WHITE)), dr.zeros(mi.SurfaceInteraction3f, len(cosine))
    hit.wi = mi.Vector3f(np.sqrt(1.0 - cosine**2), np.zeros_like(cosine), cosine)
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.Diffuse
    value = np.asarray(bsdf.eval(context, hit, hit.wi), dtype=np.float64)[0]
    return np.asarray(np.sqrt(value * np.pi / cosine))


def _transmittance(cosine: mi.Float) -> mi.Vector2f:
    """The table at cosines, for the dull and the shiny lobe."""
    place = dr.clip(cosine, 0.0, 1.0) * (_NODES - 1)
    index = dr.minimum(mi.UInt32(place), _NODES - 2)
    values = dr.gather(mi.Vector4f, _table(), index)
    return dr.lerp(mi.Vector2f(values.x, values.y), mi.Vector2f(values.z, values.w), place - mi.Float(index))
