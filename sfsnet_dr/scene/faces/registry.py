"""The face models by the name that a scene gives them.

A new model is a file with a class behind ``FaceModel``, a loader and its line in ``FACE_MODELS`` here, and
its name in ``scene.spec.FACE_SHAPES``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Final

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.faces.model import FaceModel
from sfsnet_dr.scene.spec import FACE_SHAPES, SceneSpec


def load_face_model(spec: SceneSpec) -> FaceModel:
    """Return the face model of a scene, read once per process.

    Raises:
        InputError: for a shape that is no face, a missing or damaged file.
    """
    if spec.shape not in FACE_SHAPES:
        raise InputError(
            f"{spec.name}: shape {spec.shape!r} found, a face needs one of {', '.join(FACE_SHAPES)}"
        )
    return FACE_MODELS[spec.shape](spec)


def _anny(spec: SceneSpec) -> FaceModel:
    return _load_anny(2 if spec.head.subdivision is None else spec.head.subdivision)


def _ict(spec: SceneSpec) -> FaceModel:
    return _load_ict(_model_path(spec), 1 if spec.head.subdivision is None else spec.head.subdivision)


def _basel(spec: SceneSpec) -> FaceModel:
    path = _model_path(spec)
    if spec.head.subdivision:
        raise InputError(
            f"{spec.name}: head.subdivision {spec.head.subdivision} found, 'basel' allows 0 only"
        )
    if spec.head.smile is not None:
        raise InputError(f"{spec.name}: head.smile found, the expressions of 'basel' have no names")
    return _load_basel(path)


def _model_path(spec: SceneSpec) -> Path:
    if spec.model_path is None:
        raise InputError(
            f"{spec.name}: model_path is missing, shape {spec.shape!r} is read from a file or folder"
        )
    return Path(spec.model_path)


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


#: What loads each face model.
FACE_MODELS: Final[dict[str, Callable[[SceneSpec], FaceModel]]] = {
    "anny": _anny,
    "ict": _ict,
    "basel": _basel,
}
