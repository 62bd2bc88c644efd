"""Mitsuba's path tracer in this process, in the variant of everything here (``llvm_ad_rgb``)."""

from __future__ import annotations

from sfsnet_dr.render.path_tracer import path_trace
from sfsnet_dr.render.renderers.base import Budget, Capabilities, Image
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.scene_cache import SceneCache
from sfsnet_dr.scene.subject import Subject

_scenes = SceneCache()


class MitsubaRenderer:
    """Unbiased images of everything that a subject has: shadows, gloss and light between surfaces.

    Args:
        name: for tables.
        bounces: surface points after the first; -1 has no limit.
    """

    def __init__(self, name: str, bounces: int) -> None:
        self.name = name
        self.capabilities = Capabilities(visibility=True, bounces=bounces, gloss=True, noisy=True)

    def render(self, subject: Subject, light: Light, budget: Budget) -> Image:
        """An image (H, W, 3), float64.

        Raises:
            InputError: for fewer than 2 samples.
        """
        bounces = self.capabilities.bounces
        depth = -1 if bounces < 0 else bounces + 2
        return path_trace(show_subject(subject, light), budget.samples, budget.seed, depth).mean


def show_subject(subject: Subject, light: Light | None = None) -> SurfaceScene:
    """Return the Mitsuba scene of a subject under a light (None: black); good until the next call."""
    return _scenes.show(subject.mesh, subject.camera, light, gloss=subject.spec.has_gloss)
