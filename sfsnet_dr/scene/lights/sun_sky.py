"""Daylight by Mitsuba's ``sunsky`` (Hosek and Wilkie 2012, 2013): the sky as a map, the sun apart.

The plugin's sky ends at the horizon; below lies a diffuse ground here, lit by that sky and sun.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.jit import dr, mi
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.sh.projection import equirect_directions, equirect_solid_angles

Array = npt.NDArray[np.float64]

#: Allowed height of the sun above the horizon, degrees, and turbidity of the air.
ELEVATION = (2.0, 88.0)
TURBIDITY = (1.0, 10.0)

_SUN_DEGREES = 0.5358  # diameter of the sun's disc


def sun_sky(direction: Array, turbidity: float, ground: Array, sunshine: float = 1.0) -> Light:
    """Light under a clear or hazy sky.

    Args:
        direction: (3,) unit vector toward the sun, 2 to 88 degrees above the horizon.
        turbidity: 1 (arctic) to 10 (hazy).
        ground: (3,) albedo of the ground, 0 to 1.
        sunshine: share of the sun's own light that clouds let through, 0 to 1; at 0 it gives none.

    Returns:
        Sky and ground as map, the sun as directional light, in the plugin's units (W / m^2 / nm). What lies
        outside the colours of Rec. 709, as the blue of a low sun, is clipped at 0.

    Raises:
        InputError: outside these ranges.
    """
    elevation = float(np.degrees(np.arcsin(np.clip(direction[1], -1.0, 1.0))))
    limits = {"elevation": (elevation, ELEVATION), "turbidity": (turbidity, TURBIDITY)}
    limits |= {f"ground[{k}]": (float(value), (0.0, 1.0)) for k, value in enumerate(ground)}
    limits |= {"sunshine": (sunshine, (0.0, 1.0))}
    for name, (value, (low, high)) in limits.items():
        if not low <= value <= high:
            raise InputError(f"sun_sky: {name}: {value:g} found, {low:g} to {high:g} allowed")
    settings = (direction, turbidity, float(ground @ LUMINANCE))
    sky = _evaluate("sky", equirect_directions(*MAP_SIZE).reshape(-1, 3), *settings).reshape(*MAP_SIZE, 3)
    # The disc is uniform but for the slight change of its reddening with height.
    sun = (
        sunshine
        * np.pi
        * np.sin(np.radians(_SUN_DEGREES / 2)) ** 2
        * _evaluate("sun", direction[None], *settings)[0]
    )
    height = equirect_directions(*MAP_SIZE)[..., 1]
    above = equirect_solid_angles(*MAP_SIZE) * np.maximum(height, 0.0)
    arriving = np.einsum("hw,hwc->c", above, sky) + sun * direction[1]
    environment = np.where(height[..., None] > 0, sky, ground * arriving / np.pi)
    return Light("sun_sky", environment, ((direction, sun),) if sunshine > 0 else ())


def _evaluate(part: str, directions: Array, sun: Array, turbidity: float, ground: float) -> Array:
    """Radiance (N, 3) of the sky without sun, or of the sun without sky, from directions (N, 3)."""
    emitter, parameters = _emitter(part)
    parameters["sun_direction"] = mi.Vector3f([float(x) for x in sun])
    parameters["turbidity"] = mi.Float(turbidity)
    parameters["albedo.value"] = mi.Float(ground)
    parameters.update()
    hits = dr.zeros(mi.SurfaceInteraction3f, len(directions))
    hits.wi = mi.Vector3f(-directions.T.astype(np.float32))
    return np.maximum(np.asarray(emitter.eval(hits), dtype=np.float64).T, 0.0)


@cache
def _emitter(part: str) -> tuple[Any, Any]:
    """One emitter a process, whose settings are exchanged: loading reads the model's tables anew."""
    emitter = mi.load_dict(
        {
            "type": "sunsky",
            "sun_direction": [0.0, 0.5, 0.5],
            "sun_aperture": _SUN_DEGREES,
            "sun_scale": float(part == "sun"),
            "sky_scale": float(part == "sky"),
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90),  # its up axis is z
        }
    )
    return emitter, mi.traverse(emitter)
