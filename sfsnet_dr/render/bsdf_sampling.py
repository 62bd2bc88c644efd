"""What a surface point does with light: the BSDFs of ``SurfaceScene`` in a form that is quick to trace with.

Mitsuba's ``blendbsdf`` of two ``roughplastic`` answers one question at a time and does the work of both lobes
each time; the path tracer of the references uses it. Here a point's values are computed once, and a sample
picks one kind of scattering and needs the density of that one only. Same values: a test holds them together.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from sfsnet_dr.scene.bsdf import DULL_ALPHA, NODES, SHINY_ALPHA, kernels, nodes, relative_ior
from sfsnet_dr.scene.jit import dr, mi, upload_array
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.sh.kernel import clamped_cosine

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
        self._reflectance = dr.select(self.active, scene.body_at(hit, self.active), 0.0)
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
            return [self._reflectance * float(value) for value in clamped_cosine(order) / np.pi]
        bands = [self._entering * mi.Vector2f(*map(float, pair)) for pair in kernels()[: order + 1]]
        return [self._reflectance * dr.lerp(pair.x, pair.y, self._mix) for pair in bands]

    def gloss(self, toward: mi.Vector3f) -> mi.Float:
        """Glossy reflection toward a direction, times its cosine; the same for every colour."""
        if not self._gloss:
            return mi.Float(0.0)
        half = dr.normalize(toward + self._wi)
        fresnel = mi.fresnel(dr.dot(self._wi, half), relative_ior())[0]
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
        weight = mi.fresnel(dr.dot(self._wi, normal), relative_ior())[0] * facets.smith_g1(toward, normal)
        return toward, dr.select(self.active & (toward.z > 0.0), weight, 0.0)

    def leave(self, lobe: mi.Float, sample: mi.Point2f) -> tuple[mi.Vector3f, mi.Color3f]:
        """A direction by one kind of scattering, picked by what each reflects, and that over its density."""
        toward, weight = self.leave_diffuse(sample)
        if not self._gloss:
            return toward, weight
        mirrored = mi.fresnel(self._wi.z, relative_ior())[0]
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
            return self._reflectance
        through = self._entering * _transmittance(toward.z)
        lit = self.active & (toward.z > 0.0)
        return self._reflectance * dr.select(lit, dr.lerp(through.x, through.y, self._mix), 0.0)

    def _microfacets(self, alpha: float, half: mi.Vector3f, toward: mi.Vector3f) -> mi.Float:
        facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, sample_visible=True)
        return facets.eval(half) * facets.G(self._wi, toward, half)


def prepare_scatter() -> None:
    """Read off Mitsuba's BSDF what is needed for gloss. Has to happen once, outside all symbolic loops."""
    relative_ior()
    kernels()
    _table()


@cache
def _table() -> mi.Float:
    """``scene.interface.nodes`` in memory: each node with the next one, so that one load brings a line."""
    values = np.concatenate([nodes()[:-1], nodes()[1:]], axis=1)
    return upload_array(mi.Float, values)


def _transmittance(cosine: mi.Float) -> mi.Vector2f:
    """The table at cosines, for the dull and the shiny lobe."""
    place = dr.clip(cosine, 0.0, 1.0) * (NODES - 1)
    index = dr.minimum(mi.UInt32(place), NODES - 2)
    values = dr.gather(mi.Vector4f, _table(), index)
    return dr.lerp(mi.Vector2f(values.x, values.y), mi.Vector2f(values.z, values.w), place - mi.Float(index))
