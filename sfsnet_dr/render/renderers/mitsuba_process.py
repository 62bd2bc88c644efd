"""Mitsuba in another variant than ours, which is the whole process's: run as a program by ``remote``.

The scene is described to Mitsuba's own camera, film and path integrator from the files of ``exchange``, so
that nothing but those files is shared with ``scene.mitsuba_scene``. The surface is diffuse.
"""

from __future__ import annotations

import json
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core import runtime
from sfsnet_dr.core.worker_process import Answer, serve

Image = npt.NDArray[np.float64]

#: Paths that a pass may trace at once; more take more passes.
_WAVEFRONT = 1 << 20


def render(question: Answer) -> Answer:
    """Answer one question of ``remote.RemoteRenderer``."""
    import mitsuba as mi

    bounces = int(question["bounces"])
    depth = -1 if bounces < 0 else bounces + 2
    scene = _scene(question["subject"], question["light"], depth)
    pixels = int(np.prod(scene.sensors()[0].film().size()))
    samples, total, done = int(question["samples"]), np.zeros(1), 0
    while done < samples:
        count = min(samples - done, max(1, _WAVEFRONT // pixels))
        seed = int(np.random.SeedSequence((int(question["seed"]), done)).generate_state(1)[0])
        total = total + count * np.array(mi.render(scene, spp=count, seed=seed), dtype=np.float64)
        done += count
    np.save(question["out"], (total / samples).astype(np.float32), allow_pickle=False)
    return {}


@lru_cache(maxsize=2)
def _scene(subject: str, light: str, depth: int) -> Any:
    import mitsuba as mi

    told = json.loads((Path(light) / "light.json").read_text(encoding="utf-8"))
    camera = json.loads((Path(subject) / "subject.json").read_text(encoding="utf-8"))["camera"]
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": depth, "hide_emitters": True},
        "camera": _camera(camera["distance"], camera["size"]),
        "surface": _mesh(subject),
    }
    environment = Path(light) / "environment.npy"
    if environment.exists():
        radiance = np.load(environment, allow_pickle=False).astype(np.float32)
        scene["environment"] = {"type": "envmap", "bitmap": mi.Bitmap(radiance)}
    for k, (toward, irradiance) in enumerate(told["directional"]):
        scene[f"directional{k}"] = {
            "type": "directional",
            "direction": [-x for x in toward],
            "irradiance": {"type": "rgb", "value": irradiance},
        }
    return mi.load_dict(scene)


@lru_cache(maxsize=1)
def _mesh(subject: str) -> Any:
    import mitsuba as mi

    properties = mi.Properties()
    reflectance = {"type": "mesh_attribute", "name": "vertex_color"}
    properties["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": reflectance})
    with np.load(Path(subject) / "mesh.npz", allow_pickle=False) as arrays:
        counts = len(arrays["vertices"]), len(arrays["faces"])
        mesh = mi.Mesh("surface", *counts, has_vertex_normals=True, props=properties)
        mesh.add_attribute("vertex_color", 3, arrays["albedo"].astype(np.float32).ravel())
        parameters = mi.traverse(mesh)
        for key, name, kind in (
            ("vertex_positions", "vertices", np.float32),
            ("vertex_normals", "normals", np.float32),
            ("faces", "faces", np.uint32),
        ):
            parameters[key] = type(parameters[key])(arrays[name].astype(kind).ravel())
    parameters.update()
    return mesh


def _camera(distance: float, size: int) -> dict[str, Any]:
    import mitsuba as mi

    return {
        "type": "perspective",
        "fov": 2 * np.degrees(np.arctan(1.0 / distance)),
        "to_world": mi.ScalarTransform4f().look_at([0, 0, distance], [0, 0, 0], [0, 1, 0]),
        "sampler": {"type": "independent"},
        "film": {
            "type": "hdrfilm",
            "width": size,
            "height": size,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
    }


if __name__ == "__main__":
    runtime.start(sys.argv[1])
    serve(render)
