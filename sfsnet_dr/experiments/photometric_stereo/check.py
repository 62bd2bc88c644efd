"""How right photometric stereo is on rendered faces, where the normals are known.

The faces have gloss, relief and hard cast shadows, and light bounces between their parts. The lights stand
like those of Extended Yale B; fewer than its 64 are chosen far from each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.data.databases.base import frontal_mask, heading
from sfsnet_dr.estimation.light_intensities import LightImages, estimate_light_intensities
from sfsnet_dr.estimation.photometric_stereo import photometric_stereo
from sfsnet_dr.metrics.normals import angles_deg
from sfsnet_dr.render.aovs import TransportOptions, render_aovs
from sfsnet_dr.scene.faces.face import sample_face
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.spec import CameraSpec, HeadSpec, SceneSpec

Array = npt.NDArray[np.float64]

COUNTS: Final = (4, 8, 16, 64)

#: Azimuths on the image's left by elevation (degrees) of a rig like Extended Yale B's: 64 with their mirrors.
_RIG: Final = {
    0: (0, 10, 25, 50, 70, 95, 120),
    10: (5, 20),
    -10: (5, 20),
    20: (0, 15, 60, 85, 130),
    -20: (0, 10, 35, 60, 85, 110),
    15: (35, 110),
    40: (35, 110),
    -40: (20, 50),
    45: (0, 70),
    65: (35, 110),
    -35: (0, 70),
    90: (0,),
}


def light_rig() -> Array:
    """The 64 directions toward the lamps, (64, 3)."""
    found = [
        heading(side * azimuth, elevation)
        for elevation, azimuths in _RIG.items()
        for azimuth in azimuths
        for side in ((1, -1) if azimuth else (1,))
    ]
    return np.array(found)


def spread_out(directions: Array, count: int, largest: float = 75.0) -> list[int]:
    """Indices of ``count`` lights far from each other, up to ``largest`` degrees from the viewer if possible.

    The first is the nearest to the viewer; each next one is the farthest from those before it.
    """
    if count >= len(directions):
        return list(range(len(directions)))
    allowed = np.flatnonzero(directions[:, 2] >= np.cos(np.radians(largest)))
    chosen = [int(allowed[np.argmax(directions[allowed, 2])])]
    while len(chosen) < count:
        nearest = (directions[allowed] @ directions[chosen].T).max(1)
        chosen.append(int(allowed[np.argmin(nearest)]))
    return chosen


def check_on_rendered_faces(
    seeds: Sequence[int],
    *,
    size: int = 64,
    samples: int = 64,
    spec: SceneSpec | None = None,
    on_face: Callable[[], object] = lambda: None,
) -> dict[int, Array]:
    """Mean angle to the true normals of each face, in degrees, by number of lights.

    Args:
        seeds: of the faces.
        size: width of the pictures.
        samples: camera rays a pixel, as many as there are lights or more.
        spec: of the faces; frontal ones of the default model with gloss and relief if left out.
        on_face: called after each.

    Returns:
        Number of lights -> (faces, 2) degrees over the visible face skin, with gains that are estimated where
        there are lights enough, and with the true ones, all 1.
    """
    spec = spec or SceneSpec(
        "faces", "anny", camera=CameraSpec(size=size), head=HeadSpec(yaw=5.0, pitch=5.0, roll=0.0)
    )
    spec = replace(spec, camera=replace(spec.camera, size=size))
    lights = light_rig()
    errors: dict[int, list[list[float]]] = {count: [] for count in COUNTS}
    for seed in seeds:
        images, normal, mask = _render(spec, seed, lights, samples)
        for count in COUNTS:
            chosen = spread_out(lights, count)
            names = tuple(str(light) for light in chosen)
            pixels = images[chosen].mean(-1)[:, mask].T
            gains = estimate_light_intensities([LightImages(pixels, lights[chosen], names)]).gains(
                names, lights[chosen]
            )
            found = [photometric_stereo(images[chosen], lights[chosen], g) for g in (gains, np.ones(count))]
            errors[count].append([float(angles_deg(f.normal, normal)[mask].mean()) for f in found])
        on_face()
    return {count: np.array(values) for count, values in errors.items()}


def _render(
    spec: SceneSpec, seed: int, lights: Array, samples: int
) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Pictures (N, S, S, 3) exposed for 8 bits and rounded to them, normals and mask."""
    face = sample_face(seed, spec)
    scene = SurfaceScene(face.mesh, face.pose.camera(spec.camera), gloss=spec.has_gloss)
    found = render_aovs(scene, samples, seed, TransportOptions(bounces=2), lights)
    block = frontal_mask().shape[0] // spec.camera.size
    ellipse = frontal_mask().reshape(spec.camera.size, block, spec.camera.size, block).mean((1, 3))
    mask = (found.mask > 0.99) & (ellipse > 0.5)
    exposed = found.directional / np.quantile(found.directional[:, mask], 0.995)
    return np.rint(np.clip(exposed, 0, 1) * 255) / 255, np.asarray(found.normal, np.float64), mask
