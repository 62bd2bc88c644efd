"""The face models by the name that a scene gives them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.faces.model import FaceModel
from sfsnet_dr.scene.spec import FACE_SHAPES, SceneSpec


def load_face_model(spec: SceneSpec) -> FaceModel:
    """The face model of a scene, read once per process.

    Raises:
        InputError: for a shape that is no face, a missing or damaged file.
    """
    if spec.shape not in FACE_SHAPES:
        raise InputError(
            f"{spec.name}: shape {spec.shape!r} found, a face needs one of {', '.join(FACE_SHAPES)}"
        )
    if spec.shape == "anny":
        return _load_anny(2 if spec.head.subdivision is None else spec.head.subdivision)
    if spec.model_path is None:
        raise InputError(
            f"{spec.name}: model_path is missing, shape {spec.shape!r} is read from a file or folder"
        )
    path = Path(spec.model_path)
    if spec.shape == "ict":
        return _load_ict(path, 1 if spec.head.subdivision is None else spec.head.subdivision)
    if spec.head.subdivision:
        raise InputError(
            f"{spec.name}: head.subdivision {spec.head.subdivision} found, 'basel' allows 0 only"
        )
    if spec.head.smile is not None:
        raise InputError(f"{spec.name}: head.smile found, the expressions of 'basel' have no names")
    return _load_basel(path)


@cache
def _load_anny(levels: int) -> FaceModel:
    from sfsnet_dr.scene.faces.anny import AnnyFace

    return AnnyFace(levels)


@cache
def _load_ict(path: Path, levels: int) -> FaceModel:
    from sfsnet_dr.scene.faces.ict import IctFace

    return IctFace(path, levels)


@cache
def _load_basel(path: Path) -> FaceModel:
    from sfsnet_dr.scene.faces.basel import BaselFace

    return BaselFace(path)
