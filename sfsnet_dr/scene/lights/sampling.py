"""Seeded lights of every kind, exposed and white-balanced as a camera would.

Where a face's light transport is known for a few directions only (``directions`` below), hard lights are put
there: lamps and suns are drawn from them, and surroundings with a sun are turned until it shines from one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.color import blackbody_tint
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.lights.area_lights import Panel, studio_environment
from sfsnet_dr.scene.lights.environment_map import list_maps, load_environment
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import Light, direction_from_angles, rotation_about
from sfsnet_dr.scene.lights.photo_prior import draw_photo_light
from sfsnet_dr.scene.lights.spec import LightKind, LightSpec
from sfsnet_dr.scene.lights.vmf_lobes import sample_lights
from sfsnet_dr.sh.projection import equirect_directions

Array = npt.NDArray[np.float64]

#: Greatest angle between a directional light and the viewer's direction +z, degrees.
LARGEST_ANGLE: Final = 85.0

#: Degrees by which surroundings are tilted at most to bring their sun to a direction.
LARGEST_TILT: Final = 25.0

_UP = np.array([0.0, 1.0, 0.0])
#: Albedos of the ground under a sky: grass, sand, asphalt, concrete, snow.
_GROUNDS = np.array(
    [[0.08, 0.13, 0.04], [0.42, 0.33, 0.22], [0.09, 0.09, 0.09], [0.35, 0.34, 0.31], [0.80, 0.82, 0.85]]
)


def sample_scene_light(rng: np.random.Generator, spec: LightSpec, directions: Array | None = None) -> Light:
    """Draw one light.

    Args:
        rng: the only source of randomness.
        spec: kinds and their weights, the folder of environment maps, exposure and white balance.
        directions: (D, 3) unit vectors from which hard light may come: what comes from elsewhere is made soft
            (``Light.softened``). None allows any.

    Returns:
        A light whose mean shading on faces (``Light.face_shading``) lies within ``spec.exposure``.

    Raises:
        InputError: for a folder without maps or a damaged one.
    """
    weights = spec.weights()
    kinds = list(weights)
    kind = kinds[rng.choice(len(kinds), p=np.array(list(weights.values())) / sum(weights.values()))]
    light = draw_kind(kind, rng, spec, directions).balanced(rng.uniform(*spec.white_balance))
    if directions is not None:
        light = light.softened(directions)
    return light.exposed(float(np.exp(rng.uniform(*np.log(spec.exposure)))))


def draw_kind(
    kind: LightKind, rng: np.random.Generator, spec: LightSpec, directions: Array | None = None
) -> Light:
    """Draw a light of one kind, neither exposed nor balanced; arguments as of ``sample_scene_light``."""
    return LIGHT_SAMPLERS[kind](rng, spec, directions)


def sample_direction(rng: np.random.Generator, largest: float = LARGEST_ANGLE) -> Array:
    """A direction (3,) within an angle of +z, degrees, uniform in solid angle."""
    z = rng.uniform(np.cos(np.radians(largest)), 1.0)
    turn, radius = rng.uniform(0, 2 * np.pi), np.sqrt(1 - z * z)
    return np.array([radius * np.cos(turn), radius * np.sin(turn), z])


def turn_to(toward: Array, target: Array) -> Array:
    """(3, 3) rotation that takes one direction to another: about the vertical, then a tilt of the rest."""
    azimuths = [np.degrees(np.arctan2(d[0], d[2])) for d in (toward, target)]
    heights = [np.degrees(np.arcsin(np.clip(d[1], -1.0, 1.0))) for d in (toward, target)]
    sideways = direction_from_angles(azimuths[1] + 90.0, 0.0)
    return rotation_about(sideways, heights[0] - heights[1]) @ rotation_about(_UP, azimuths[1] - azimuths[0])


def _map_from_file(rng: np.random.Generator, spec: LightSpec, directions: Array | None) -> Light:
    if spec.environments is None:
        raise InputError("light: environments: no folder found, lights of kind 'hdr' need one with maps")
    maps = list_maps(spec.environments)
    light = load_environment(maps[rng.integers(len(maps))])
    turn = rotation_about(_UP, rng.uniform(0, 360))
    tilt = rotation_about(direction_from_angles(rng.uniform(0, 360), 0.0), rng.uniform(0, 10))
    if directions is None or not light.directional:
        return light.turned(tilt @ turn)
    sun = light.directional[0][0]
    heights = np.degrees(np.arcsin(np.clip(directions[:, 1], -1, 1)) - np.arcsin(np.clip(sun[1], -1, 1)))
    fitting = np.flatnonzero(np.abs(heights) <= LARGEST_TILT)
    if not len(fitting):
        return light.turned(tilt @ turn)
    return light.turned(turn_to(sun, directions[rng.choice(fitting)]))


def _daylight(rng: np.random.Generator, directions: Array | None) -> Light:
    """Sun and sky: the sun free, dimmed by thin cloud, or hidden."""
    from sfsnet_dr.scene.lights.sun_sky import ELEVATION, sun_sky

    low, high = ELEVATION[0] + 3.0, 75.0
    sun = direction_from_angles(rng.uniform(-180, 180), rng.uniform(low, high))
    sunshine = float(rng.choice([1.0, rng.uniform(0.05, 1.0), 0.0], p=[0.5, 0.3, 0.2]))
    if directions is not None and sunshine > 0:
        heights = np.degrees(np.arcsin(np.clip(directions[:, 1], -1.0, 1.0)))
        fitting = np.flatnonzero((heights >= low) & (heights <= high))
        if len(fitting):
            sun = directions[rng.choice(fitting)]
    ground = _GROUNDS[rng.integers(len(_GROUNDS))] * rng.uniform(0.7, 1.0)
    return sun_sky(sun, float(1 + 9 * rng.beta(1.5, 3.0)), ground, sunshine)


def _studio(rng: np.random.Generator) -> Light:
    """A key panel in front, perhaps a fill, a rim light behind and a hair light above, in a dim room."""
    side = rng.choice([-1.0, 1.0])
    key_tint = _tint(rng)
    panels = [
        _panel(rng, direction_from_angles(side * rng.uniform(0, 70), rng.uniform(-15, 60)), 1.0, key_tint)
    ]
    if rng.random() < 0.6:
        fill = direction_from_angles(-side * rng.uniform(10, 80), rng.uniform(-30, 40))
        panels.append(
            _panel(rng, fill, rng.uniform(0.1, 0.6), key_tint if rng.random() < 0.6 else _tint(rng))
        )
    if rng.random() < 0.4:
        rim = direction_from_angles(rng.choice([-1, 1]) * rng.uniform(100, 160), rng.uniform(-10, 50))
        panels.append(_panel(rng, rim, rng.uniform(0.3, 1.5), _tint(rng)))
    if rng.random() < 0.2:
        panels.append(
            _panel(rng, direction_from_angles(rng.uniform(-180, 180), 80), rng.uniform(0.2, 0.8), _tint(rng))
        )
    walls = _tint(rng) * rng.uniform(0.01, 0.15)
    return Light("studio", studio_environment(tuple(panels), walls, walls * rng.uniform(0.2, 1.5)))


def _panel(rng: np.random.Generator, direction: Array, share: float, tint: Array) -> Panel:
    """A panel that gives a surface facing it about ``share`` of the shading of a white dome."""
    width, height = np.exp(rng.uniform(np.log(12.0), np.log(35.0), 2))
    if rng.random() < 0.4:
        height = width
    solid_angle = np.pi * np.sin(np.radians(width)) * np.sin(np.radians(height))
    return Panel(
        direction=direction,
        half_size=(float(width), float(height)),
        roll=float(rng.uniform(-30, 30)),
        soft=float(rng.uniform(3.0, 8.0)),
        radiance=tint * share * np.pi / solid_angle,
        round=bool(rng.random() < 0.4),
    )


def _lamps(rng: np.random.Generator, directions: Array | None) -> Light:
    """One to three lamps, each weaker than the one before, over a dim dome."""
    count = int(rng.choice([1, 2, 3], p=[0.6, 0.25, 0.15]))
    if directions is None:
        toward = [sample_direction(rng) for _ in range(count)]
    else:
        toward = list(directions[rng.permutation(len(directions))[:count]])
    powers = np.pi * np.cumprod([1.0, *rng.uniform(0.2, 0.8, len(toward) - 1)])
    lamps = tuple((d, power * _tint(rng)) for d, power in zip(toward, powers, strict=True))
    return Light("directional", _dome(rng, float(np.exp(rng.uniform(*np.log([0.02, 0.4]))))), lamps)


def _dome(rng: np.random.Generator, level: float) -> Array:
    """Uniform but for a vertical gradient, (64, 128, 3)."""
    height = equirect_directions(*MAP_SIZE)[..., 1:2]
    return np.asarray(level * (1 + rng.uniform(-0.4, 0.9) * height) * _tint(rng))


def _tint(rng: np.random.Generator) -> Array:
    """Colour (3,) of luminance 1, of a black body of 2500 to 10000 K, evenly in 1/T."""
    return np.asarray(blackbody_tint(1 / rng.uniform(1 / 10000, 1 / 2500)))


#: What draws each kind of light: (rng, spec, directions) -> light. A new kind is a file, a line here, and its
#: weight in ``LightSpec``.
LIGHT_SAMPLERS: Final[dict[LightKind, Callable[[np.random.Generator, LightSpec, Array | None], Light]]] = {
    "hdr": _map_from_file,
    "sun_sky": lambda rng, spec, directions: _daylight(rng, directions),
    "studio": lambda rng, spec, directions: _studio(rng),
    "directional": lambda rng, spec, directions: _lamps(rng, directions),
    "ambient": lambda rng, spec, directions: Light("ambient", _dome(rng, 1.0)),
    "lobes": lambda rng, spec, directions: Light("lobes", sample_lights(rng, 1)[0].equirect(*MAP_SIZE)),
    "fitted": lambda rng, spec, directions: draw_photo_light(rng, spec.light_prior_file),
}
