"""Stored references: means and variances of path-traced pictures, and maps for shading models.

One EXR for each scene and light holds a mean and a variance for every model of light transport; one for each
scene holds its maps. Their metadata says what they were made from; what does not fit is refused.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import output_dir
from sfsnet_dr.core.image_io import read_exr, write_exr
from sfsnet_dr.core.provenance import versions
from sfsnet_dr.experiments.regression.config import RegressSpec
from sfsnet_dr.experiments.regression.models import Model, trace_model
from sfsnet_dr.metrics.equivalence import Estimate
from sfsnet_dr.render.aovs import TransportOptions, render_aovs
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.subject import Subject

Array = npt.NDArray[np.float64]

#: Version of the layout, and of what the numbers mean.
FORMAT: Final = "1"

#: References are made with seeds from here on; runs take theirs from below.
FIRST_SEED: Final = 1_000_000

_CAPTURES = 16  # whose spread says how well the maps are known
_COLOURS, _AXES = "RGB", "XYZ"
_MAKE = "`sfsnet-dr regress --update` makes the references again"


@dataclass(frozen=True, eq=False)
class Maps:
    """What shading models start from, and how well it is known.

    Attributes:
        normal: (H, W, 3) unit vectors, 0 where nothing is seen.
        albedo: (H, W, 3) linear, times the share of the pixel that the surface covers.
        normal_deviation: (H, W) length of the normal's standard deviation.
        albedo_deviation: (H, W, 3) standard deviation.
    """

    normal: Array
    albedo: Array
    normal_deviation: Array
    albedo_deviation: Array


class References:
    """A folder of references.

    Args:
        folder: where they lie.
        across_versions: whether references of another Mitsuba are taken, to compare versions.
    """

    def __init__(self, folder: Path | str, *, across_versions: bool = False) -> None:
        self.folder, self._across = Path(folder), across_versions

    def picture(self, subject: Subject, light: Light, model: Model) -> Estimate:
        """The stored picture of a model.

        Raises:
            InputError: if it is missing, or was made with another version, scene or light.
        """
        path = self.path(subject.spec.name, light.name)
        planes = self._read(path, _identity(subject, light))
        if f"{model.name}.mean.R" not in planes:
            raise InputError(
                f"{path}: no picture of {model.name!r} found; {_MAKE}, with --renderers for one of your own"
            )
        mean, variance = (_stack(planes, f"{model.name}.{part}", _COLOURS) for part in ("mean", "variance"))
        return Estimate(mean, variance)

    def maps(self, subject: Subject) -> Maps:
        """The stored maps of a scene.

        Raises:
            InputError: as ``picture``.
        """
        planes = self._read(self.path(subject.spec.name, "maps"), _identity(subject, None))
        return Maps(
            _stack(planes, "normal", _AXES),
            _stack(planes, "albedo", _COLOURS),
            planes["normal_deviation"].astype(np.float64),
            _stack(planes, "albedo_deviation", _COLOURS),
        )

    def path(self, scene: str, light: str) -> Path:
        """The file of a scene and light, or of a scene's ``maps``."""
        return self.folder / f"{scene}.{light}.exr"

    def _read(self, path: Path, identity: dict[str, str]) -> dict[str, npt.NDArray[np.float32]]:
        if not path.is_file():
            raise InputError(f"{path}: no such reference; {_MAKE}")
        planes, metadata = read_exr(path)
        for key, wanted in identity.items():
            found = metadata.get(f"sfsnet_dr:{key}", "nothing")
            if found != wanted and not (key == "mitsuba" and self._across):
                raise InputError(f"{path}: made for {key} {found}, {wanted} is needed; {_MAKE}")
        return planes


def make_references(
    spec: RegressSpec,
    folder: Path | str,
    scenes: Iterable[tuple[Subject, list[Light]]],
    models: Callable[[Subject], list[Model]],
    on_file: Callable[[], None] = lambda: None,
) -> None:
    """Make the references of scenes again; each file is whole or not there.

    Args:
        spec: says with how many samples.
        folder: where they go.
        scenes: subjects with their lights.
        models: the models that a subject needs.
        on_file: called after each file.
    """
    library = References(output_dir(folder))
    for subject, lights in scenes:
        name = subject.spec.name
        _write(library.path(name, "maps"), _map_planes(subject, spec.reference_maps), subject, None, spec)
        on_file()
        for light in lights:
            planes: dict[str, Array] = {}
            for model in models(subject):
                seed = FIRST_SEED + 2 * len(planes)
                picture = trace_model(subject, light, model, spec.reference_samples, seed)
                planes |= _planes(f"{model.name}.mean", picture.mean, _COLOURS)
                planes |= _planes(f"{model.name}.variance", _coarse(picture.variance), _COLOURS)
            _write(library.path(name, light.name), planes, subject, light, spec)
            on_file()


def light_hash(light: Light) -> str:
    """A short hash of a light's numbers to four digits: rounding on another machine does not change it."""
    digest = hashlib.sha256()
    parts = [] if light.environment is None else [light.environment]
    for direction, irradiance in light.directional:
        parts += [direction, irradiance]
    for part in parts:
        # Steps of 1e-4 of the largest value, set off so that round numbers do not lie on a step's edge.
        steps = np.floor(np.asarray(part) / max(np.abs(part).max(), 1e-30) * 1e4 + 0.3719)
        digest.update(steps.astype("<i8").tobytes())
    return digest.hexdigest()[:16]


def scene_hash(subject: Subject) -> str:
    """A short hash of what a scene's file says about surface and camera, and of the seed.

    What it leaves at its default does not count, so that a new option does not make references useless; nor
    do its sampling and its own lights, which a reference does not use.
    """
    said = {k: v for k, v in _said(subject.spec).items() if k not in ("sampling", "light")}
    text = json.dumps([said, subject.seed], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _said(spec: Any) -> dict[str, Any]:
    """The values of a dataclass that are not its defaults, nested ones likewise."""
    found = {}
    for field in dataclasses.fields(spec):
        value = getattr(spec, field.name)
        if dataclasses.is_dataclass(value):
            inner = _said(value)
            if inner:
                found[field.name] = inner
        elif field.default is dataclasses.MISSING or value != field.default:
            found[field.name] = value
    return found


def _identity(subject: Subject, light: Light | None) -> dict[str, str]:
    """What a reference has to have been made for."""
    scene = {"scene hash": scene_hash(subject)}
    lit = {} if light is None else {"light hash": light_hash(light)}
    return {"format": FORMAT, **scene, **lit, "mitsuba": versions(["mitsuba"]).get("mitsuba", "none")}


def _write(
    path: Path, planes: dict[str, Array], subject: Subject, light: Light | None, spec: RegressSpec
) -> None:
    facts = {
        **_identity(subject, light),
        "scene": subject.spec.name,
        "light": "none" if light is None else light.name,
        "samples": str(spec.reference_samples),
        "maps": str(spec.reference_maps),
        "seeds": f"from {FIRST_SEED}",
    }
    metadata = {f"sfsnet_dr:{key}": value for key, value in facts.items()}
    write_exr(path, planes, metadata, float32=set(planes))


def _map_planes(subject: Subject, rays: int) -> dict[str, Array]:
    scene = SurfaceScene(subject.mesh, subject.camera)
    each = max(rays // _CAPTURES, 1)
    found = [render_aovs(scene, each, FIRST_SEED + k, TransportOptions(order=0)) for k in range(_CAPTURES)]
    normals = np.stack([maps.normal for maps in found]).astype(np.float64)
    albedo = np.stack([maps.albedo * maps.coverage[..., None] for maps in found]).astype(np.float64)
    mean = normals.mean(axis=0)
    length = np.maximum(np.linalg.norm(mean, axis=-1, keepdims=True), 1e-12)
    spread = np.sqrt(normals.var(axis=0, ddof=1).sum(axis=-1) / _CAPTURES)
    deviation = np.sqrt(albedo.var(axis=0, ddof=1) / _CAPTURES)
    return {
        **_planes("normal", mean / length, _AXES),
        **_planes("albedo", albedo.mean(axis=0), _COLOURS),
        "normal_deviation": _coarse(spread),
        **_planes("albedo_deviation", _coarse(deviation), _COLOURS),
    }


def _planes(name: str, image: Array, letters: str) -> dict[str, Array]:
    return {f"{name}.{letter}": image[..., k] for k, letter in enumerate(letters)}


def _stack(planes: dict[str, npt.NDArray[np.float32]], name: str, letters: str) -> Array:
    return np.stack([planes[f"{name}.{letter}"] for letter in letters], axis=-1).astype(np.float64)


def _coarse(values: Array) -> Array:
    """Values rounded to 7 bits, 0.4 %: nobody knows a variance better, and the file is half as large."""
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.round(mantissa * 128) / 128, exponent)
