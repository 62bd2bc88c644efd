"""A Mitsuba scene that is built once; afterwards faces and environments are exchanged in place.

This is the only file that names Mitsuba's mesh and emitter parameters (they change in Mitsuba 3.10).
Importing it chooses the variant.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.scene.bsdf import DULL_ALPHA, PLUGIN, SHINY_ALPHA, body_share, lobe
from sfsnet_dr.scene.jit import dr, mi, upload_array
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.mesh import Mesh
from sfsnet_dr.scene.spec import CameraSpec

Array = npt.NDArray[np.float64]

_ALBEDO = "vertex_color"
_BODY = "vertex_body"  # reflectance under the interface; equal to the albedo without one
_MIX = "vertex_roughness_mix"
_REGION = "face_region"  # one label a triangle; labels of vertices cannot be interpolated


class SurfaceScene:
    """One mesh and one camera, lit by an environment map, by directional lights, or by both.

    The surface is diffuse, or with ``gloss`` a diffuse body under a rough dielectric interface: Mitsuba's
    ``roughplastic`` with two lobes, mixed by the mesh's ``roughness_mix``.

    Convention: as in ``base.conventions``; the environment follows ``sh.projection``.

    Args:
        mesh: the first surface. Later ones need the same number of vertices and of triangles.
        camera: where the camera stands; its image size is fixed, its distance can be exchanged.
        directional: pairs of (3,) direction toward the light and (3,) irradiance on a surface that faces it.
        environment: whether there is an environment map; if not said, there is one without ``directional``
            only: the path tracer would waste its samples on a black one.
        gloss: whether the surface has the glossy lobes.
    """

    def __init__(
        self,
        mesh: Mesh,
        camera: CameraSpec,
        directional: Sequence[tuple[Array, Array]] = (),
        *,
        environment: bool | None = None,
        gloss: bool = False,
    ) -> None:
        self.camera, self.gloss = camera, gloss
        self._vertex_count, self._face_count = len(mesh.vertices), len(mesh.faces)
        self._directional_count = len(directional)
        self._has_environment = not directional if environment is None else environment
        self._surface = _mesh(mesh, gloss)
        scene: dict[str, Any] = {"type": "scene", "camera": _sensor(camera), "surface": self._surface}
        if self._has_environment:
            black = np.zeros((*MAP_SIZE, 3), dtype=np.float32)
            scene["environment"] = {"type": "envmap", "bitmap": mi.Bitmap(black)}
        for k, (direction, irradiance) in enumerate(directional):
            scene[f"directional{k}"] = _directional(direction, irradiance)
        self.mi_scene = mi.load_dict(scene)
        self._parameters = mi.traverse(self.mi_scene)
        self._parameters.keep([r"surface\..*", r"environment\.data", r"directional\d+\..*", r"camera\..*"])

    @property
    def bsdf(self) -> mi.BSDF:
        """The surface's BSDF itself: calls to it need no dispatch over the BSDFs of all scenes."""
        return self._surface.bsdf()

    def meet(
        self, ray: mi.Ray3f, active: mi.Bool | bool = True, *, coherent: bool = False
    ) -> mi.PreliminaryIntersection3f:
        """Where rays meet the surface first, if they do: what is needed to tell, and for ``hit_at``."""
        return self.mi_scene.ray_intersect_preliminary(ray, coherent, active)

    def hit_at(
        self, ray: mi.Ray3f, met: mi.PreliminaryIntersection3f, active: mi.Bool
    ) -> mi.SurfaceInteraction3f:
        """Position, normal, shading frame, and the local direction that rays came from, where they met it.

        As ``mi.Scene.ray_intersect``, but without dispatch: there is one surface.
        """
        flags = mi.RayFlags.Minimal | mi.RayFlags.ShadingFrame
        hit = self._surface.compute_surface_interaction(ray, met, flags, active)
        hit.t, hit.prim_index = dr.select(active, met.t, dr.inf), met.prim_index
        hit.initialize_sh_frame()
        hit.wi = hit.to_local(-ray.d)
        return hit

    def albedo_at(self, hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Color3f:
        """Linear albedo at a hit."""
        return self._surface.eval_attribute_3(_ALBEDO, hit, active)

    def body_at(self, hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Color3f:
        """Reflectance that the BSDF has at a hit: under the interface, where there is gloss."""
        return self._surface.eval_attribute_3(_BODY, hit, active)

    def roughness_mix_at(self, hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Float:
        """Share of the shiny lobe at a hit."""
        return self._surface.eval_attribute_1(_MIX, hit, active)

    def region_at(self, hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UInt32:
        """Label of ``scene.mesh.Region`` of the triangle at a hit."""
        return mi.UInt32(self._surface.eval_attribute_1(_REGION, hit, active) + 0.5)

    def fits(self, mesh: Mesh, camera: CameraSpec) -> bool:
        """Whether a mesh and camera can be shown by this scene without building another."""
        counts = (len(mesh.vertices), len(mesh.faces))
        return camera.size == self.camera.size and counts == (self._vertex_count, self._face_count)

    def set_camera(self, camera: CameraSpec) -> None:
        """Move the camera.

        Raises:
            InputError: for another image size.
        """
        if camera.size != self.camera.size:
            raise InputError(
                f"camera.size: {camera.size} found, {self.camera.size} expected; make a new SurfaceScene"
            )
        if camera == self.camera:
            return
        sensor = _sensor(camera)
        self._parameters["camera.to_world"] = mi.Transform4f(sensor["to_world"].matrix)
        self._parameters["camera.x_fov"] = mi.Float(sensor["fov"])
        self._parameters.update()
        self.camera = camera

    def set_mesh(self, mesh: Mesh) -> None:
        """Exchange triangles, positions, normals, albedo, gloss and regions; what rays hit follows.

        Goes through the scene's parameters: through the mesh's own, rays would go on hitting the old surface.

        Raises:
            InputError: if the mesh has other counts than the first one.
        """
        if not self.fits(mesh, self.camera):
            raise InputError(
                f"mesh: {len(mesh.vertices)} vertices and {len(mesh.faces)} triangles found, "
                f"{self._vertex_count} and {self._face_count} expected; make a new SurfaceScene"
            )
        for key, values in _mesh_values(mesh, self.gloss).items():
            self._parameters[f"surface.{key}"] = values
        self._parameters.update()

    def set_environment(self, image: Array | float) -> None:
        """Exchange the environment.

        Args:
            image: (64, 128, 3) linear radiance in the convention of ``sh.projection``, or one number.

        Raises:
            InputError: for another shape, values that are no radiance, or a scene with directional lights.
        """
        if not self._has_environment:
            raise InputError("environment: this scene has directional lights only; make another SurfaceScene")
        full = np.broadcast_to(np.asarray(image, dtype=np.float32), (*MAP_SIZE, 3))
        check_shape("environment", full, f"{MAP_SIZE[0]} {MAP_SIZE[1]} 3")
        if not np.isfinite(full).all() or full.min() < 0:
            raise InputError(
                "environment: NaN, inf or negative radiance found, finite values from 0 on allowed"
            )
        wrapped = np.concatenate([full[:, -1:], full, full[:, :1]], axis=1)
        self._parameters["environment.data"] = mi.TensorXf(wrapped)
        self._parameters.update()

    def set_directional(self, lights: Sequence[tuple[Array, Array]]) -> None:
        """Exchange the directional lights.

        Args:
            lights: as many pairs of direction and irradiance as the scene was made with.

        Raises:
            InputError: for another number of lights.
        """
        if len(lights) != self._directional_count:
            raise InputError(
                f"directional: {len(lights)} lights found, {self._directional_count} expected; "
                "make a new SurfaceScene"
            )
        for k, (direction, irradiance) in enumerate(lights):
            frame = mi.Frame3f(mi.Vector3f(*(-float(x) for x in direction)))
            columns = [[*frame.s, 0], [*frame.t, 0], [*frame.n, 0], [0, 0, 0, 1]]
            matrix = np.array([[float(np.ravel(x)[0]) for x in column] for column in columns]).T
            self._parameters[f"directional{k}.to_world"] = mi.Transform4f(matrix)
            self._parameters[f"directional{k}.irradiance.value"] = mi.Color3f(*(float(x) for x in irradiance))
        self._parameters.update()


def camera_rays(camera: CameraSpec, pixel: mi.UInt32, offset: mi.Point2f) -> mi.Ray3f:
    """Rays through pixels, numbered row * size + column, at offsets in [0, 1)^2 from the upper left."""
    size = dr.opaque(mi.Float, camera.size)
    distance = dr.opaque(mi.Float, camera.distance)
    column, row = mi.Float(pixel % camera.size), mi.Float(pixel // camera.size)
    x = 2.0 * (column + offset.x) / size - 1.0
    y = 1.0 - 2.0 * (row + offset.y) / size
    origin = mi.Point3f(0.0, 0.0, distance)
    return mi.Ray3f(origin, dr.normalize(mi.Vector3f(x, y, -distance)))


def _mesh(mesh: Mesh, gloss: bool) -> mi.Mesh:
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_bsdf(gloss))
    shape = mi.Mesh("surface", len(mesh.vertices), len(mesh.faces), has_vertex_normals=True, props=properties)
    shape.add_attribute(_ALBEDO, 3, np.zeros(3 * len(mesh.vertices), dtype=np.float32))
    shape.add_attribute(_BODY, 3, np.zeros(3 * len(mesh.vertices), dtype=np.float32))
    shape.add_attribute(_MIX, 1, np.zeros(len(mesh.vertices), dtype=np.float32))
    shape.add_attribute(_REGION, 1, np.zeros(len(mesh.faces), dtype=np.float32))
    parameters = mi.traverse(shape)
    for key, values in _mesh_values(mesh, gloss).items():
        parameters[key] = values
    parameters.update()
    return shape


def _bsdf(gloss: bool) -> dict[str, Any]:
    body = {"type": PLUGIN, "name": _BODY}
    if not gloss:
        return {"type": "diffuse", "reflectance": body}
    return {
        "type": "blendbsdf",
        "weight": {"type": "mesh_attribute", "name": _MIX},
        "dull": lobe(DULL_ALPHA, body),
        "shiny": lobe(SHINY_ALPHA, body),
    }


def _mesh_values(mesh: Mesh, gloss: bool) -> dict[str, mi.Float | mi.UInt32]:
    mix = np.zeros(len(mesh.vertices)) if mesh.roughness_mix is None else mesh.roughness_mix
    body = mesh.albedo / body_share(mix)[:, None] if gloss else mesh.albedo
    floats: dict[str, npt.NDArray[Any]] = {
        "vertex_positions": mesh.vertices,
        "vertex_normals": mesh.normals,
        _ALBEDO: mesh.albedo,
        _BODY: body,
        _MIX: mix,
        _REGION: _triangle_labels(mesh),
    }
    values = {key: upload_array(mi.Float, array) for key, array in floats.items()}
    return {"faces": upload_array(mi.UInt32, mesh.faces), **values}


def _triangle_labels(mesh: Mesh) -> npt.NDArray[np.uint8]:
    """(F,) label that two corners share, else the first corner's."""
    first, second, third = (mesh.regions[mesh.faces[:, k]] for k in range(3))
    return np.where(second == third, second, first)


def _sensor(camera: CameraSpec) -> dict[str, Any]:
    return {
        "type": "perspective",
        "fov": 2 * np.degrees(np.arctan(1.0 / camera.distance)),
        "to_world": mi.ScalarTransform4f().look_at([0, 0, camera.distance], [0, 0, 0], [0, 1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": camera.size,
            "height": camera.size,
            "rfilter": {"type": "box"},
            "component_format": "float32",
        },
    }


def _directional(direction: Array, irradiance: Array) -> dict[str, Any]:
    return {
        "type": "directional",
        "direction": [float(-x) for x in direction],  # Mitsuba wants the way the light travels
        "irradiance": {"type": "rgb", "value": [float(x) for x in irradiance]},
    }
