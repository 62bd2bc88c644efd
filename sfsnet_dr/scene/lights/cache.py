"""Thousands of lights drawn once and kept as coefficients and lamps, for relighting without end.

Drawing a light takes 10 ms and more: maps are turned, skies evaluated, all projected. A face is relit in less
time, so lights are drawn before training, and what is left per image is done to all images of a batch at once
(``data.lighting``). They are kept neither exposed nor white-balanced: both follow when it is known how a
light stands before a face.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.config import as_dict
from sfsnet_dr.core.errors import check_shape
from sfsnet_dr.core.files import atomic_path
from sfsnet_dr.core.provenance import sha256
from sfsnet_dr.scene.lights.environment_map import MOST, list_maps
from sfsnet_dr.scene.lights.light import MAP_ORDER, Light
from sfsnet_dr.scene.lights.photo_prior import FITTED, read_mixture
from sfsnet_dr.scene.lights.sampling import draw_kind
from sfsnet_dr.scene.lights.spec import LightSpec

Array = npt.NDArray[np.float64]

#: Random stream of a bank's lights, apart from those of batches.
_STREAM: Final = 2
_FORMAT: Final = "sfsnet_dr.lights.1"
_COUNT: Final = (MAP_ORDER + 1) ** 2


@dataclass(frozen=True, eq=False)
class LightCache:
    """N lights, neither exposed nor white-balanced.

    Attributes:
        radiance: radiance coefficients of order 4 of the maps alone, (N, 25, 3).
        toward: unit vectors toward the directional lights, strongest first, (N, 4, 3); 0 where there is none.
        power: their irradiance on a surface that faces them, (N, 4, 3); 0 where there is none.
        free: whether each light's lamps may come from anywhere, as in a studio; suns belong to their sky;
            (N,).
        fingerprint: of what they were drawn from; the same for the same lights.
    """

    radiance: Array
    toward: Array
    power: Array
    free: npt.NDArray[np.bool_]
    fingerprint: str

    def __post_init__(self) -> None:
        sizes = check_shape("radiance", self.radiance, f"N {_COUNT} 3")
        check_shape("toward", self.toward, f"N {MOST} 3", **sizes)
        check_shape("power", self.power, f"N {MOST} 3", **sizes)
        check_shape("free", self.free, "N", **sizes)

    def __len__(self) -> int:
        return len(self.radiance)


def draw_lights(
    spec: LightSpec, count: int, seed: int, on_light: Callable[[], object] | None = None
) -> LightCache:
    """Draw lights, calling ``on_light`` after each; light n depends on the spec, the seed and n alone.

    Raises:
        InputError: for a folder of maps that cannot be read.
    """
    weights = spec.weights()
    kinds, shares = list(weights), np.array(list(weights.values()))

    def light(number: int) -> tuple[Light, bool]:
        rng = np.random.default_rng([seed, _STREAM, number])
        kind = kinds[rng.choice(len(kinds), p=shares / shares.sum())]
        drawn = draw_kind(kind, rng, spec)
        if on_light is not None:
            on_light()
        return drawn, kind == "directional"

    return light_cache_of((light(n) for n in range(count)), light_fingerprint(spec, count, seed))


def light_cache_of(lights: Iterable[tuple[Light, bool]], fingerprint: str = "") -> LightCache:
    """A bank of given lights, each with whether its lamps may come from anywhere."""
    rows = [(*_compact(light), free) for light, free in lights]
    radiance, toward, power, free = (np.array(column) for column in zip(*rows, strict=True))
    return LightCache(radiance, toward, power, free, fingerprint)


def light_fingerprint(spec: LightSpec, count: int, seed: int) -> str:
    """A hash of all that decides a bank, the maps' bytes included but not where they lie.

    Raises:
        InputError: if the folder of maps is missing or empty.
    """
    plain = as_dict(spec)
    if spec.environments is not None:
        plain["environments"] = [sha256(path) for path in list_maps(spec.environments)]
    if spec.fitted:
        plain["mixture"] = read_mixture(spec.light_prior_file or FITTED).digest
    text = json.dumps([_FORMAT, plain, count, seed], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def load_or_draw_lights(
    path: Path, spec: LightSpec, count: int, seed: int, on_light: Callable[[], object] | None = None
) -> LightCache:
    """The bank that a file keeps; drawn and written there if the file is missing or holds another."""
    fingerprint = light_fingerprint(spec, count, seed)
    if path.is_file() and (found := _read(path)) is not None and found.fingerprint == fingerprint:
        return found
    bank = draw_lights(spec, count, seed, on_light)
    with atomic_path(path) as partial, partial.open("wb") as file:
        np.savez(
            file,
            radiance=bank.radiance,
            toward=bank.toward,
            power=bank.power,
            free=bank.free,
            fingerprint=np.array(bank.fingerprint),
        )
    return bank


def _read(path: Path) -> LightCache | None:
    """None for a file that was cut off or damaged: it can be made again."""
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            arrays = {name: file[name] for name in ("radiance", "toward", "power", "free")}
            return LightCache(**arrays, fingerprint=str(file["fingerprint"]))
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None


def _compact(light: Light) -> tuple[Array, Array, Array]:
    toward, power = np.zeros((MOST, 3)), np.zeros((MOST, 3))
    for k, lamp in enumerate(light.directional):
        toward[k], power[k] = lamp
    return light.environment_coefficients().values, toward, power
