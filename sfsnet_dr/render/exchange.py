"""Subjects and lights as files, for renderers in processes of their own.

A subject is a folder of ``subject.json`` (its scene, seed and camera) and ``mesh.npz``: ``vertices``,
``faces``, ``normals``, ``albedo``, ``regions`` and, with gloss, ``roughness_mix``, as ``scene.mesh.Mesh`` has
them. A light is a folder of ``light.json`` (its name, and its directional lights as pairs of direction and
irradiance) and, if there is an environment, ``environment.npy`` (64, 128, 3). Nothing is pickled.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.base.config import as_dict, build
from sfsnet_dr.scene.lights import SceneLight
from sfsnet_dr.scene.mesh import Mesh
from sfsnet_dr.scene.spec import CameraSpec, SceneSpec
from sfsnet_dr.scene.subject import Subject

T = TypeVar("T", Subject, SceneLight)

#: Version of the format.
FORMAT: Final = 1

_ARRAYS = ("vertices", "faces", "normals", "albedo", "regions")


def write_subject(folder: Path, subject: Subject) -> None:
    """Write a subject into an existing folder."""
    mesh = subject.mesh
    arrays: dict[str, npt.NDArray[Any]] = {name: getattr(mesh, name) for name in _ARRAYS}
    if mesh.roughness_mix is not None:
        arrays["roughness_mix"] = mesh.roughness_mix
    np.savez(folder / "mesh.npz", allow_pickle=False, **arrays)
    told = {
        "format": FORMAT,
        "spec": as_dict(subject.spec),
        "seed": subject.seed,
        "camera": as_dict(subject.camera),
    }
    (folder / "subject.json").write_text(json.dumps(told), encoding="utf-8")


def read_subject(folder: Path) -> Subject:
    """The subject of a folder, equal to the one written.

    Raises:
        BadInput: for a folder of another format.
    """
    told = _read(folder / "subject.json")
    spec = build(SceneSpec, _without_none(told["spec"]), str(folder))
    camera = build(CameraSpec, _without_none(told["camera"]), str(folder))
    with np.load(folder / "mesh.npz", allow_pickle=False) as arrays:
        mesh = Mesh(**{name: arrays[name] for name in arrays.files})
    return Subject(spec, int(told["seed"]), mesh, camera)


def write_light(folder: Path, light: SceneLight) -> None:
    """Write a light into an existing folder."""
    if light.environment is not None:
        np.save(folder / "environment.npy", light.environment, allow_pickle=False)
    lamps = [[list(map(float, part)) for part in lamp] for lamp in light.directional]
    told = {"format": FORMAT, "name": light.name, "directional": lamps}
    (folder / "light.json").write_text(json.dumps(told), encoding="utf-8")


def read_light(folder: Path) -> SceneLight:
    """The light of a folder, equal to the one written.

    Raises:
        BadInput: for a folder of another format.
    """
    told, path = _read(folder / "light.json"), folder / "environment.npy"
    environment = np.load(path, allow_pickle=False) if path.exists() else None
    lamps = tuple((np.array(toward), np.array(power)) for toward, power in told["directional"])
    return SceneLight(told["name"], environment, lamps)


def _written(write: Callable[[Path, T], None]) -> Callable[[T], Path]:
    """Write each thing once, into a temporary folder that lives as long as the thing."""
    folders: weakref.WeakKeyDictionary[T, Path] = weakref.WeakKeyDictionary()

    def folder_of(thing: T) -> Path:
        if thing not in folders:
            folder = Path(tempfile.mkdtemp(prefix="sfsnet_dr-"))
            weakref.finalize(thing, shutil.rmtree, folder, ignore_errors=True)
            write(folder, thing)
            folders[thing] = folder
        return folders[thing]

    return folder_of


#: Folder of a subject or light, written when first asked for; another subject has another folder.
subject_folder = _written(write_subject)
light_folder = _written(write_light)


def _read(path: Path) -> dict[str, Any]:
    told: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    if told.get("format") != FORMAT:
        raise BadInput(f"{path}: format {told.get('format')!r} found, {FORMAT} expected")
    return told


def _without_none(table: dict[str, Any]) -> dict[str, Any]:
    """Keys without a value left out, as in TOML, which has no None."""
    kept = {key: value for key, value in table.items() if value is not None}
    return {key: _without_none(value) if isinstance(value, dict) else value for key, value in kept.items()}
