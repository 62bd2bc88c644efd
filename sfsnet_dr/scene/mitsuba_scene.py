"""A Mitsuba scene that is built once; afterwards faces and environments are exchanged in place.

This is the only file that names Mitsuba's mesh and emitter parameters (they change in Mitsuba 3.10).
Importing it chooses the variant.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.checks import BadInput, check_shape
from sfsnet_dr.scene.jit import dr, mi
from sfsnet_dr.scene.mesh import FACE_REGIONS, Mesh
from sfsnet_dr.scene.spec import CameraSpec

Array = npt.NDArray[np.float64]

#: Size of the environment map: rows, columns. 64 x 128 texels resolve the sharpest lobe of the light prior.
ENVIRONMENT_SIZE = (64, 128)

_ALBEDO = "vertex_color"
_FACE = "vertex_face"  # 1 on face skin, 0 elsewhere


class SurfaceScene:
    """One mesh and one camera, lit by an environment map or by directional lights.

    Convention: as in ``base.conventions``; the environment follows ``sh.projection``.

    Args:
        mesh: the first surface. Later ones need the same number of vertices and the same triangles.
        camera: where the camera stands.
        directional: pairs of (3,) direction toward the light and (3,) irradiance on a surface that faces it;
            with any, there is no environment: the path tracer would waste its samples on a black one.
    """

    def __init__(
        self, mesh: Mesh, camera: CameraSpec, directional: Sequence[tuple[Array, Array]] = ()
    ) -> None:
        self.camera = camera
        self._vertex_count, self._face_count = len(mesh.vertices), len(mesh.faces)
        self._has_environment = not directional
        scene: dict[str, Any] = {"type": "scene", "camera": _sensor(camera), "surface": _mesh(mesh)}
        if self._has_environment:
            black = np.zeros((*ENVIRONMENT_SIZE, 3), dtype=np.float32)
            scene["environment"] = {"type": "envmap", "bitmap": mi.Bitmap(black)}
        for k, (direction, irradiance) in enumerate(directional):
            scene[f"directional{k}"] = _directional(direction, irradiance)
        self.mi_scene = mi.load_dict(scene)
        self._parameters = mi.traverse(self.mi_scene)
        self._parameters.keep([r"surface\..*", r"environment\.data"])

    def fits(self, mesh: Mesh, camera: CameraSpec) -> bool:
        """Whether a mesh and camera can be shown by this scene without building another."""
        counts = (len(mesh.vertices), len(mesh.faces))
        return camera == self.camera and counts == (self._vertex_count, self._face_count)

    def set_mesh(self, mesh: Mesh) -> None:
        """Exchange positions, normals, albedo and the face mask; the acceleration structure follows.

        Goes through the scene's parameters: through the mesh's own, rays would go on hitting the old surface.

        Raises:
            BadInput: if the mesh has other counts than the first one.
        """
        if not self.fits(mesh, self.camera):
            raise BadInput(
                f"mesh: {len(mesh.vertices)} vertices and {len(mesh.faces)} triangles found, "
                f"{self._vertex_count} and {self._face_count} expected; make a new SurfaceScene"
            )
        for key, values in _mesh_values(mesh).items():
            self._parameters[f"surface.{key}"] = mi.Float(values)
        self._parameters.update()

    def set_environment(self, image: Array | float) -> None:
        """Exchange the environment.

        Args:
            image: (64, 128, 3) linear radiance in the convention of ``sh.projection``, or one number.

        Raises:
            BadInput: for another shape, values that are no radiance, or a scene with directional lights.
        """
        if not self._has_environment:
            raise BadInput("environment: this scene has directional lights only; make another SurfaceScene")
        full = np.broadcast_to(np.asarray(image, dtype=np.float32), (*ENVIRONMENT_SIZE, 3))
        check_shape("environment", full, f"{ENVIRONMENT_SIZE[0]} {ENVIRONMENT_SIZE[1]} 3")
        if not np.isfinite(full).all() or full.min() < 0:
            raise BadInput(
                "environment: NaN, inf or negative radiance found, finite values from 0 on allowed"
            )
        wrapped = np.concatenate([full[:, -1:], full, full[:, :1]], axis=1)
        self._parameters["environment.data"] = mi.TensorXf(wrapped)
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


def albedo_at(hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Color3f:
    """Linear albedo at a hit: what the surface's BSDF uses."""
    return hit.shape.eval_attribute_3(_ALBEDO, hit, active)


def face_at(hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
    """Whether a hit lies on face skin."""
    return hit.shape.eval_attribute_1(_FACE, hit, active) > 0.5


def _mesh(mesh: Mesh) -> mi.Mesh:
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(
        {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": _ALBEDO}}
    )
    shape = mi.Mesh("surface", len(mesh.vertices), len(mesh.faces), has_vertex_normals=True, props=properties)
    shape.add_attribute(_ALBEDO, 3, np.zeros(3 * len(mesh.vertices), dtype=np.float32))
    shape.add_attribute(_FACE, 1, np.zeros(len(mesh.vertices), dtype=np.float32))
    parameters = mi.traverse(shape)
    parameters["faces"] = mi.UInt32(mesh.faces.ravel())
    for key, values in _mesh_values(mesh).items():
        parameters[key] = mi.Float(values)
    parameters.update()
    return shape


def _mesh_values(mesh: Mesh) -> dict[str, npt.NDArray[np.float32]]:
    on_face = np.isin(mesh.regions, FACE_REGIONS)
    values = {
        "vertex_positions": mesh.vertices,
        "vertex_normals": mesh.normals,
        _ALBEDO: mesh.albedo,
        _FACE: on_face,
    }
    return {key: np.ascontiguousarray(array, dtype=np.float32).ravel() for key, array in values.items()}


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
