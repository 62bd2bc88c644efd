"""Mitsuba's path tracer in this process, in the variant of everything here (``llvm_ad_rgb``)."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import Final

from sfsnet_dr.render.path_tracer import path_trace
from sfsnet_dr.render.renderers.base import Budget, Capabilities, Image
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.subject import Subject

#: Scenes that are kept to be lit, or filled with another surface, again: building one takes longer.
_KEPT: Final = 4


@dataclass(eq=False)
class _Kept:
    scene: SurfaceScene
    subject: Subject


_scenes: OrderedDict[tuple[int | bool, ...], _Kept] = OrderedDict()


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
        return path_trace(_lit(subject, light), budget.samples, budget.seed, depth).mean


def _lit(subject: Subject, light: Light) -> SurfaceScene:
    scene = _with_surface(subject, light)
    if light.environment is not None:
        scene.set_environment(light.environment)
    if light.directional:
        scene.set_directional(light.directional)
    return scene


def _with_surface(subject: Subject, light: Light) -> SurfaceScene:
    """A scene of the subject with room for the light: Mitsuba's scenes are exchanged, not built again."""
    mesh, camera, gloss = subject.mesh, subject.camera, subject.spec.has_gloss
    lit = light.environment is not None
    key = (len(mesh.vertices), len(mesh.faces), camera.size, len(light.directional), lit, gloss)
    kept = _scenes.pop(key, None)
    if kept is None:
        made = SurfaceScene(mesh, camera, light.directional, environment=lit, gloss=gloss)
        kept = _Kept(made, subject)
    elif kept.subject is not subject:
        kept.scene.set_mesh(mesh)
        kept.scene.set_camera(camera)
        kept.subject = subject
    _scenes[key] = kept
    while len(_scenes) > _KEPT:
        _scenes.popitem(last=False)
    return kept.scene
