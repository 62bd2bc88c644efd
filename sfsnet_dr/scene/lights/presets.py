"""The lights that renderers are judged under, by name: from what order 2 renders exactly to what it cannot.

Every light is exposed alike (``Light.exposed``), so that errors in 8-bit units compare. Names are
stable: records carry them.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError, nearest
from sfsnet_dr.scene.lights.area_lights import Panel, studio_environment
from sfsnet_dr.scene.lights.environment_map import list_maps, load_environment
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import Light, direction_from_angles
from sfsnet_dr.scene.lights.vmf_lobes import sample_lights
from sfsnet_dr.sh.projection import equirect_directions

Array = npt.NDArray[np.float64]

#: Mean shading of a face (``Light.face_shading``, luminance). Skin is then middle grey, and no white
#: clips under any light but the hardest from the side.
EXPOSURE: Final = 0.5

#: Where the light of ``bands`` and ``directional`` points or is tilted to: the upper right of the image.
_ASIDE = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0])
_OBLIQUE = np.array([0.5, 0.5, np.sqrt(0.5)])
_WHITE = np.ones(3)
_ANGLES = (0, 30, 60, 85)
_NATURAL, _NATURAL_SEED = 3, 20

_Maker = Callable[[], Light]


def light_set(names: str, environments: Path | str | None = None) -> list[Light]:
    """Lights by names.

    Args:
        names: a set of ``light_sets``, a light's own name, or several of them with commas between.
        environments: a folder of environment maps (.exr, .hdr); each joins ``environments`` and ``all`` under
            its file's name.

    Returns:
        The lights in a fixed order, each once.

    Raises:
        InputError: for a name that is unknown, with the nearest known one, or bad maps.
    """
    makers = _makers() | ({} if environments is None else _from_files(environments))
    sets = light_sets(environments)
    chosen: set[str] = set()
    for name in (part.strip() for part in names.split(",")):
        if name not in sets and name not in makers:
            raise InputError(f"light {name!r}: unknown; {nearest(name, [*sets, *makers])}")
        chosen |= set(sets.get(name, (name,)))
    return [makers[name]() for name in makers if name in chosen]


def light_sets(environments: Path | str | None = None) -> dict[str, tuple[str, ...]]:
    """The sets and the names of the lights in them; arguments as of ``light_set``."""
    files = () if environments is None else tuple(_from_files(environments))
    directional = tuple(f"directional{angle}" for angle in _ANGLES)
    bands = tuple(f"band{band}" for band in (1, 2, 3, 4))
    natural = tuple(f"natural{k}" for k in range(_NATURAL))
    environment = (*natural, "studio", "overcast", *files)
    return {
        "standard": ("constant", *natural, "studio", "directional0", "directional60", "sun_sky"),
        "constant": ("constant",),
        "bands": bands,
        "natural": natural,
        "environments": environment,
        "directional": directional,
        "sun_sky": ("sun_sky",),
        "two_colours": ("two_colours",),
        "all": ("constant", *bands, *environment, *directional, "sun_sky", "two_colours"),
    }


def require_light(light: Light) -> Light:
    """The light itself, if it is one.

    Raises:
        InputError: for a light of all zeros, under which every renderer is right.
    """
    powers = [power.max() for _, power in light.directional]
    if light.environment is not None:
        powers.append(light.environment.max())
    if not max(powers) > 0:
        raise InputError(
            f"light {light.name!r}: all zeros found; errors are relative, so some light is needed"
        )
    return light


def describe_light(light: Light) -> str:
    """What a light of a set is, in a few words; for others, what they are made of."""
    word = light.name.rstrip("0123456789")
    number = light.name[len(word) :]
    known = {
        "constant": "the same from everywhere",
        "band": f"a constant and SH band {number}",
        "natural": "soft lobes over a dome",
        "studio": "three panels in a dim room",
        "overcast": "sky behind clouds",
        "directional": f"one lamp, {number} degrees off the viewer",
        "sun_sky": "clear sky with its sun",
        "two_colours": "a warm and a cool lamp",
    }
    made_of = [*["a map"] * (light.environment is not None), *["lamps"] * bool(light.directional)]
    return known.get(word, " and ".join(made_of))


def constant_light() -> Light:
    """The same radiance from everywhere: order 0 holds all of it."""
    return Light("constant", np.ones((*MAP_SIZE, 3))).exposed(EXPOSURE)


def band_light(number: int) -> Light:
    """A constant and one harmonic of a band, as strong as it can be without negative light.

    The harmonic is the zonal one about the upper right, 45 degrees from the viewer.
    """
    legendre = np.polynomial.Legendre.basis(number)
    lowest = float(legendre(np.linspace(-1, 1, 20001)).min())
    values = np.maximum(1.0 - legendre(equirect_directions(*MAP_SIZE) @ _OBLIQUE) / lowest, 0.0)
    return Light(f"band{number}", np.repeat(values[..., None], 3, axis=-1)).exposed(EXPOSURE)


def natural_light(number: int) -> Light:
    """A dome with soft lobes of the light prior (``sh.priors``), the same as in the demo."""
    lights = sample_lights(np.random.default_rng(_NATURAL_SEED), _NATURAL)
    return Light(f"natural{number}", lights[number].equirect(*MAP_SIZE)).exposed(EXPOSURE)


def studio_light() -> Light:
    """A key panel from the upper right, a weaker fill from the left and a rim light, in a dim room."""
    panels = (
        _panel(direction_from_angles(40, 30), (20.0, 20.0), 10.0 * _WHITE),
        _panel(direction_from_angles(-50, 5), (30.0, 30.0), 1.5 * np.array([0.9, 1.0, 1.15])),
        _panel(direction_from_angles(150, 25), (12.0, 30.0), 12.0 * np.array([1.1, 1.0, 0.85])),
    )
    return Light("studio", studio_environment(panels, np.full(3, 0.08), np.full(3, 0.05))).exposed(EXPOSURE)


def directional_light(angle: float) -> Light:
    """One white lamp, ``angle`` degrees from the viewer's direction toward the upper right."""
    toward = np.cos(np.radians(angle)) * np.array([0.0, 0.0, 1.0]) + np.sin(np.radians(angle)) * _ASIDE
    return Light(f"directional{angle:g}", None, ((toward, np.pi * _WHITE),)).exposed(EXPOSURE)


def two_color_light() -> Light:
    """A warm lamp from the left and a cool one from the upper right, both hard."""
    warm, cool = np.array([1.0, 0.45, 0.15]), np.array([0.2, 0.5, 1.0])
    lamps = ((direction_from_angles(-50, 10), np.pi * warm), (direction_from_angles(40, 35), np.pi * cool))
    return Light("two_colours", None, lamps).exposed(EXPOSURE)


def sun_and_sky(name: str, sunshine: float) -> Light:
    """The sun 40 degrees high at the upper right, or the same sky behind clouds, over grey ground."""
    from sfsnet_dr.scene.lights.sun_sky import sun_sky

    light = sun_sky(direction_from_angles(35, 40), 3.0, np.full(3, 0.25), sunshine)
    return Light(name, light.environment, light.directional).balanced(1.0).exposed(EXPOSURE)


@cache
def _makers() -> dict[str, _Maker]:
    makers: dict[str, _Maker] = {"constant": constant_light}
    makers |= {f"band{k}": partial(band_light, k) for k in (1, 2, 3, 4)}
    makers |= {f"natural{k}": partial(natural_light, k) for k in range(_NATURAL)}
    makers |= {"studio": studio_light, "overcast": partial(sun_and_sky, "overcast", 0.0)}
    makers |= {f"directional{a}": partial(directional_light, a) for a in _ANGLES}
    return makers | {"sun_sky": partial(sun_and_sky, "sun_sky", 1.0), "two_colours": two_color_light}


def _from_files(folder: Path | str) -> dict[str, _Maker]:
    """Makers of the maps of a folder, named after their files in the letters that records allow."""
    paths = list_maps(folder)
    names = ["map_" + re.sub(r"[^a-z0-9]+", "_", path.stem.lower()).strip("_") for path in paths]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InputError(f"{folder}: two environment maps named {twice[0]!r} found; rename one")
    return {name: partial(_map, name, path) for name, path in zip(names, paths, strict=True)}


def _map(name: str, path: Path) -> Light:
    light = load_environment(path)
    return Light(name, light.environment, light.directional).exposed(EXPOSURE)


def _panel(direction: Array, half_size: tuple[float, float], radiance: Array) -> Panel:
    return Panel(direction, half_size, roll=0.0, soft=5.0, radiance=radiance, round=False)
