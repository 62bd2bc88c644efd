"""Mitsuba scenes that are kept and filled with the next surface and light: building one takes longer."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.mesh import Mesh
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.spec import CameraSpec

_Key = tuple[int, int, int, int, bool, bool]


@dataclass(eq=False)
class _Entry:
    scene: SurfaceScene
    mesh: Mesh


class SceneCache:
    """The most recently used scenes, one for each kind of surface and light.

    Scenes differ where Mitsuba cannot exchange things in place: the numbers of vertices, triangles, pixels
    and directional lights, whether there is an environment map, and whether the surface has gloss.

    Args:
        capacity: scenes that are kept, at least 1.
    """

    def __init__(self, capacity: int = 4) -> None:
        self._capacity = capacity
        self._entries: OrderedDict[_Key, _Entry] = OrderedDict()

    def show(
        self, mesh: Mesh, camera: CameraSpec, light: Light | None = None, *, gloss: bool
    ) -> SurfaceScene:
        """Return a scene with this surface, camera and light; it is good until the next call.

        Args:
            mesh: the surface; the same object is not uploaded again.
            camera: where the camera stands.
            light: what lights it; None leaves the environment as it was, for callers that set their own.
            gloss: whether the surface has the glossy lobes.

        Raises:
            InputError: for a mesh or light that ``SurfaceScene`` refuses.
        """
        directional = () if light is None else light.directional
        environment = light is None or light.environment is not None
        key = (len(mesh.vertices), len(mesh.faces), camera.size, len(directional), environment, gloss)
        entry = self._entries.pop(key, None)
        if entry is None:
            entry = _Entry(
                SurfaceScene(mesh, camera, directional, environment=environment, gloss=gloss), mesh
            )
        elif entry.mesh is not mesh:
            entry.scene.set_mesh(mesh)
            entry.mesh = mesh
        entry.scene.set_camera(camera)
        self._entries[key] = entry
        while len(self._entries) > self._capacity:
            self._entries.popitem(last=False)
        if light is not None and light.environment is not None:
            entry.scene.set_environment(light.environment)
        if directional:
            entry.scene.set_directional(directional)
        return entry.scene
