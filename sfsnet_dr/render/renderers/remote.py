"""Renderers in processes of their own: files that go in and out, Mitsuba variants and Cycles.

A subject is a folder of ``subject.json`` (its scene, seed and camera) and ``mesh.npz``: ``vertices``,
``faces``, ``normals``, ``albedo``, ``regions`` and, with gloss, ``roughness_mix``, as ``scene.mesh.Mesh`` has
them. A light is a folder of ``light.json`` (its name, and its directional lights as pairs of direction and
irradiance) and, if there is an environment, ``environment.npy`` (64, 128, 3). Nothing is pickled.

Mitsuba's variant belongs to a whole process. Cycles comes with Blender (``bpy``), under the GPL and with an
older NumPy: it lives in an environment of its own that ``make cycles`` sets up, and only files pass between.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
import weakref
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.config import as_dict, build_dataclass
from sfsnet_dr.core.errors import InputError, NotInstalled, RunError
from sfsnet_dr.core.worker_process import WorkerFailed, WorkerProcess
from sfsnet_dr.render.renderers.base import Budget, Capabilities, Image
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.mesh import Mesh
from sfsnet_dr.scene.spec import CameraSpec, SceneSpec
from sfsnet_dr.scene.subject import Subject

T = TypeVar("T", Subject, Light)

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
        InputError: for a folder of another format.
    """
    told = _read(folder / "subject.json")
    spec = build_dataclass(SceneSpec, _without_none(told["spec"]), str(folder))
    camera = build_dataclass(CameraSpec, _without_none(told["camera"]), str(folder))
    with np.load(folder / "mesh.npz", allow_pickle=False) as arrays:
        mesh = Mesh(**{name: arrays[name] for name in arrays.files})
    return Subject(spec, int(told["seed"]), mesh, camera)


def write_light(folder: Path, light: Light) -> None:
    """Write a light into an existing folder."""
    if light.environment is not None:
        np.save(folder / "environment.npy", light.environment, allow_pickle=False)
    lamps = [[list(map(float, part)) for part in lamp] for lamp in light.directional]
    told = {"format": FORMAT, "name": light.name, "directional": lamps}
    (folder / "light.json").write_text(json.dumps(told), encoding="utf-8")


def read_light(folder: Path) -> Light:
    """The light of a folder, equal to the one written.

    Raises:
        InputError: for a folder of another format.
    """
    told, path = _read(folder / "light.json"), folder / "environment.npy"
    environment = np.load(path, allow_pickle=False) if path.exists() else None
    lamps = tuple((np.array(toward), np.array(power)) for toward, power in told["directional"])
    return Light(told["name"], environment, lamps)


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
        raise InputError(f"{path}: format {told.get('format')!r} found, {FORMAT} expected")
    return told


def _without_none(table: dict[str, Any]) -> dict[str, Any]:
    """Keys without a value left out, as in TOML, which has no None."""
    kept = {key: value for key, value in table.items() if value is not None}
    return {key: _without_none(value) if isinstance(value, dict) else value for key, value in kept.items()}


#: Seconds that one image may take.
TIME_LIMIT: Final = 1800.0

Command = tuple[tuple[str, ...], Mapping[str, str]]

_children: dict[tuple[str, ...], WorkerProcess] = {}


class RemoteRenderer:
    """A renderer behind a process that is started once and kept.

    Args:
        name: for tables.
        capabilities: what it accounts for.
        command: gives the program and its environment when the first image is asked for. The program takes
            questions of ``subject`` and ``light`` (folders of ``render.exchange``), ``samples``, ``seed``,
            ``bounces`` and ``out``, and writes an image (H, W, 3), float32, to ``out``.
    """

    def __init__(self, name: str, capabilities: Capabilities, command: Callable[[], Command]) -> None:
        self.name, self.capabilities = name, capabilities
        self._command = command

    def render(self, subject: Subject, light: Light, budget: Budget) -> Image:
        """An image (H, W, 3), float32.

        Raises:
            NotInstalled: if the program is missing.
            RunError: if it gave no image.
        """
        child = self._child()
        with tempfile.TemporaryDirectory(prefix="sfsnet_dr-") as folder:
            out = Path(folder) / "image.npy"
            question = {
                "subject": str(subject_folder(subject)),
                "light": str(light_folder(light)),
                "samples": budget.samples,
                "seed": budget.seed,
                "bounces": self.capabilities.bounces,
                "out": str(out),
            }
            try:
                answer = child.ask(question, TIME_LIMIT)
            except WorkerFailed as failed:
                raise RunError(f"{self.name}: {failed}") from failed
            if "error" in answer:
                raise RunError(f"{self.name}: {answer['error']}")
            image: Image = np.load(out, allow_pickle=False)
            return image

    def _child(self) -> WorkerProcess:
        command, environment = self._command()
        child = _children.get(command)
        if child is None or not child.alive:
            child = _children[command] = WorkerProcess(command, environment)
        return child


def our_python(*arguments: str) -> Command:
    """A module of ours, in a Python that finds the same packages as this one."""
    return (sys.executable, *arguments), {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


#: Names a Python that can import ``bpy``, where it is not in ``.venv-cycles``.
CYCLES_VARIABLE: Final = "SFSNET_DR_CYCLES_PYTHON"

#: What installs it, in a checkout.
CYCLES_COMMAND: Final = "make cycles"

_ENVIRONMENT = Path(".venv-cycles")
_SCRIPT = Path(__file__).with_name("cycles_process.py")
_VARIANTS = {"mitsuba-scalar": "scalar_rgb", "mitsuba-spectral": "llvm_ad_spectral"}


def make_remote(tracer: str, depth: str, bounces: int) -> RemoteRenderer:
    """A renderer by the two parts of its name; all of them leave gloss out."""
    capabilities = Capabilities(visibility=True, bounces=bounces, noisy=True)
    command = cycles_command if tracer == "cycles" else partial(_mitsuba_command, _VARIANTS[tracer])
    return RemoteRenderer(f"{tracer}-{depth}", capabilities, command)


def cycles_python() -> Path:
    """The Python of Blender's environment.

    It is named by the environment variable, or lies in ``.venv-cycles`` of this checkout or of the current
    folder.

    Raises:
        NotInstalled: if there is none, or ``make cycles`` has not finished.
    """
    named = os.environ.get(CYCLES_VARIABLE)
    if named:
        if Path(named).is_file():
            return Path(named)
        raise NotInstalled(f"cycles: not installed ({CYCLES_VARIABLE}={named} is no file): {CYCLES_COMMAND}")
    checkout = Path(__file__).resolve().parents[3]
    for folder in (checkout / _ENVIRONMENT, Path.cwd() / _ENVIRONMENT):
        if (folder / ".ready").is_file():
            return folder / "bin" / "python"
    raise NotInstalled(f"cycles: not installed (no {_ENVIRONMENT} here): {CYCLES_COMMAND}")


def cycles_version() -> str:
    """Version of ``bpy``, as far as it can be read without starting it.

    Raises:
        NotInstalled: as ``cycles_python``.
    """
    environment = cycles_python().parent.parent
    found = sorted(environment.glob("lib/python*/site-packages/bpy-*.dist-info"))
    return found[0].name.split("-")[1].removesuffix(".dist") if found else "of unknown version"


def cycles_command() -> Command:
    """The script inside Blender's environment."""
    # Neither our packages nor a user's Blender settings may get into it.
    clean = {"PYTHONPATH": "", "PYTHONNOUSERSITE": "1", "BLENDER_USER_RESOURCES": os.devnull}
    return (str(cycles_python()), str(_SCRIPT)), clean


def _mitsuba_command(variant: str) -> Command:
    return our_python("-m", "sfsnet_dr.render.renderers.mitsuba_process", variant)
