"""What is compared: scenes, lights and renderers, as ``eval/regress.toml`` says."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import sfsnet_dr
from sfsnet_dr.core.config import load_toml
from sfsnet_dr.core.errors import InputError, nearest
from sfsnet_dr.scene.spec import SamplingSpec, SceneSpec
from sfsnet_dr.scene.subject import load_spec_by_name

#: Where the matrix and its references lie in a checkout.
FOLDER: Final = Path(sfsnet_dr.__file__).parents[1] / "eval"
CONFIG: Final = FOLDER / "regress.toml"
REFERENCES: Final = FOLDER / "references"

#: Rays behind the SH renderers' maps and transport: enough that one 8 x 8 block is known to 0.3 %.
_SAMPLING: Final = SamplingSpec(spp=64, paths_per_hit=4)


@dataclass(frozen=True)
class SceneLights:
    """A scene and the lights that it is compared under, by name."""

    scene: str
    lights: tuple[str, ...]


@dataclass(frozen=True)
class KnownDifference:
    """How far a renderer may be from its truth by design; its noise comes on top.

    Attributes:
        renderer: its name.
        cause: why, for people.
        scenes: where; everywhere if empty.
        relative: at most this part of a pixel.
        edges: in pixels, how far apart it may see a contour, such as the edge of a shadow.
    """

    renderer: str
    cause: str
    scenes: tuple[str, ...] = ()
    relative: float = 0.0
    edges: float = 0.0


@dataclass(frozen=True)
class RegressSpec:
    """The matrix.

    Attributes:
        scenes: what is rendered.
        renderers: who renders it, where nobody says otherwise; renderers of other packages come on top.
        size: width and height of the images.
        seeds: images of each renderer; their spread says how noisy it is.
        samples: paths a pixel in each of them.
        level: chance that a run in which nothing is wrong fails.
        reference_samples: paths a pixel of a reference.
        reference_maps: camera rays a pixel of the maps that shading models are held to.
        known: differences that are not held against a renderer.
    """

    scenes: tuple[SceneLights, ...]
    renderers: tuple[str, ...]
    size: int = 64
    seeds: int = 8
    samples: int = 32
    level: float = 0.01
    reference_samples: int = 4096
    reference_maps: int = 4096
    known: tuple[KnownDifference, ...] = ()

    def known_of(self, renderer: str, scene: str) -> list[KnownDifference]:
        """What is known of a renderer on a scene."""
        return [k for k in self.known if k.renderer == renderer and (not k.scenes or scene in k.scenes)]

    def scene(self, name: str) -> SceneSpec:
        """A scene at the size and with the sampling of the matrix."""
        spec = load_spec_by_name(name)
        return replace(spec, camera=replace(spec.camera, size=self.size), sampling=_SAMPLING)


def read_spec(path: Path | str) -> RegressSpec:
    """Read and check a matrix.

    Raises:
        InputError: naming the file and key, what was found and what is allowed.
    """
    spec = load_toml(RegressSpec, path)
    limits = {
        "size": (spec.size, 16, 512),
        "seeds": (spec.seeds, 3, 64),
        "samples": (spec.samples, 2, 65536),
        "level": (spec.level, 1e-9, 0.5),
        "reference_samples": (spec.reference_samples, 64, 1 << 20),
        "reference_maps": (spec.reference_maps, 64, 1 << 16),
        "scenes": (len(spec.scenes), 1, 1000),
    }
    for key, (value, low, high) in limits.items():
        if not low <= value <= high:
            raise InputError(f"{path}: {key}: {value} found, {low} to {high} allowed")
    for known in spec.known:
        _check_known(path, spec, known)
    return spec


def _check_known(path: Path | str, spec: RegressSpec, known: KnownDifference) -> None:
    where = f"{path}: known: {known.renderer}"
    if not known.cause.strip():
        raise InputError(f"{where}: no cause found; say why it may differ")
    for key, value, high in (("relative", known.relative, 0.5), ("edges", known.edges, 1.0)):
        if not 0 <= value <= high:
            raise InputError(f"{where}: {key}: {value} found, 0 to {high} allowed")
    scenes = [pair.scene for pair in spec.scenes]
    for scene in known.scenes:
        if scene not in scenes:
            raise InputError(f"{where}: scene {scene!r}: not in the matrix; {nearest(scene, scenes)}")


def choose_pairs(
    spec: RegressSpec, scenes: str | None, lights: str | None, renderers: str | None
) -> RegressSpec:
    """The part of a matrix that was asked for, by names with commas between.

    A light may be asked for that the matrix does not have for a scene; renderers need not be in it at all.

    Raises:
        InputError: for a scene or light that the matrix lacks, with the nearest one.
    """
    pairs = spec.scenes
    if scenes is not None:
        wanted = _names(scenes, [pair.scene for pair in pairs], "scene")
        pairs = tuple(pair for pair in pairs if pair.scene in wanted)
    if lights is not None:
        wanted = _names(lights, [light for pair in pairs for light in pair.lights], "light")
        kept = (SceneLights(p.scene, tuple(x for x in p.lights if x in wanted)) for p in pairs)
        pairs = tuple(pair for pair in kept if pair.lights)
    names = spec.renderers if renderers is None else tuple(_split(renderers))
    return replace(spec, scenes=pairs, renderers=names)


def _names(text: str, known: list[str], kind: str) -> list[str]:
    names = _split(text)
    for name in names:
        if name not in known:
            raise InputError(f"{kind} {name!r}: not in the matrix; {nearest(name, set(known))}")
    return names


def _split(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise InputError(f"{text!r} found, names with commas between are needed")
    return list(dict.fromkeys(names))
