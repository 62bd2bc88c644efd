"""A subject: the mesh and camera that renderers are compared on; validation scenes by name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

import sfsnet_dr
from sfsnet_dr.core.errors import InputError, nearest
from sfsnet_dr.scene.faces.face import sample_face
from sfsnet_dr.scene.mesh import SHAPES, Mesh
from sfsnet_dr.scene.spec import CameraSpec, SceneSpec, load_scene, refuse_light


@dataclass(frozen=True, eq=False)
class Subject:
    """A surface before a camera.

    Attributes:
        spec: what it was made from; says its name, and whether it has gloss.
        seed: of a head; nothing else depends on it.
        mesh: the surface, in the frame of ``base.conventions``.
        camera: where the camera stands.
    """

    spec: SceneSpec
    seed: int
    mesh: Mesh
    camera: CameraSpec


def build_subject(spec: SceneSpec, seed: int = 0) -> Subject:
    """The surface that a spec describes, and the camera that looks at it."""
    if spec.shape in SHAPES:
        mesh = SHAPES[spec.shape](spec.albedo or (0.5, 0.5, 0.5))
        return Subject(spec, seed, mesh, replace(spec.camera, focal=None))
    face = sample_face(seed, spec)
    return Subject(spec, seed, face.mesh, face.pose.camera(spec.camera))


_FOLDER = Path("scenes", "validation")


def validation_scenes() -> dict[str, Path]:
    """Path of every validation scene by its name, sorted.

    Raises:
        InputError: if the installation has lost them.
    """
    # A checkout has them beside the package. A wheel brings them as data, which its metadata finds, except
    # where pip installed it with --target: then they lie in share/ beside the package.
    beside = Path(sfsnet_dr.__file__).parents[1]
    folders = (beside / _FOLDER, beside / "share" / "sfsnet_dr" / _FOLDER)
    paths = next((found for f in folders if (found := sorted(f.glob("*.toml")))), None) or _installed()
    if not paths:
        raise InputError(
            f"{beside}: no validation scenes found; install sfsnet_dr again, or give a file (.toml)"
        )
    return {path.stem: path for path in paths}


def find_scene(scene: Path | str) -> Path:
    """The file of a scene that is given by its name or by a path.

    Raises:
        InputError: for an unknown name, with the nearest known one, or a missing file.
    """
    path = Path(scene)
    if path.suffix == ".toml" or len(path.parts) > 1:
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        return path
    known = validation_scenes()
    if path.name not in known:
        raise InputError(f"scene {path.name!r}: unknown; {nearest(path.name, known)}, or a file (.toml)")
    return known[path.name]


def load_spec_by_name(scene: Path | str, model_path: Path | str | None = None) -> SceneSpec:
    """The specification of a scene that is given by its name or by a path.

    Args:
        scene: such as ``"head"`` or ``"my/scene.toml"``.
        model_path: where the scene's face model lies, in place of what the file says.

    Raises:
        InputError: as ``find_scene`` and ``load_scene``, or for a scene with a ``[light]`` table.
    """
    spec = refuse_light(
        load_scene(find_scene(scene)), scene, "the command chooses the lights (--lights, or its own file)"
    )
    return spec if model_path is None else replace(spec, model_path=str(model_path))


def load_subject_by_name(scene: Path | str, seed: int = 0, model_path: Path | str | None = None) -> Subject:
    """The subject of a scene that is given by its name or by a path; arguments as of ``load_spec_by_name``.

    Raises:
        InputError: as there, or for a missing or damaged face model.
    """
    return build_subject(load_spec_by_name(scene, model_path), seed)


def _installed() -> list[Path]:
    try:
        files = metadata.files("sfsnet_dr") or []
    except metadata.PackageNotFoundError:
        return []
    ours = (Path(str(file.locate())) for file in files if file.parent.match(str(_FOLDER)))
    return sorted(path.resolve() for path in ours if path.is_file())
