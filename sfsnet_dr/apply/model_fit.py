"""The paper's baseline "3DMM": a face model fitted to landmarks, its normals, and the light on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from sfsnet_dr.apply.methods import Answer, Method, divided
from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.base.color import LUMINANCE
from sfsnet_dr.fit.face_fit import CLIPPED, face_maps
from sfsnet_dr.fit.landmark_fit import fit_landmarks
from sfsnet_dr.fit.light_fit import MEAN_SKIN, fit_light
from sfsnet_dr.scene.face_modes import FaceModes

Array = npt.NDArray[np.float64]

#: Pixels below which a fit of light takes what it otherwise leaves out.
_FEW: Final = 200
#: Difference of a picture's colours, relative to its brightest value, below which it is grey.
_GREY: Final = 1e-3


class _Fitted(NamedTuple):
    normal: Array
    bare: Array


class ModelFit:
    """The face model's normals, light by least squares on bare skin, albedo = image / shading.

    Light: plain least squares under a mean skin's albedo (``fit.light_fit`` with ``robust=False``, which
    under single lamps tells lights apart better than robust weights do). Pixels that are clipped are left out
    unless hardly any are not. Where the model is not seen the nearest of its normals stands.

    A face is fitted when its first image is asked for, so that this time counts, once for all of its images.

    Args:
        model: of ``scene.face_modes``.
        landmarks: (68, 2) each in the canonical frame, by the name of the capture, or by whatever is given
            as the subjects where ``of_capture`` is not used.

    Raises:
        BadInput: without landmarks; when called, for a name that has none.
    """

    name = "3dmm"

    def __init__(self, model: FaceModes, landmarks: Mapping[str, Array]) -> None:
        if not landmarks:
            raise BadInput("landmarks: none found, those of one face at least are needed")
        self.model, self.landmarks = model, dict(landmarks)
        self._fitted: dict[str, _Fitted] = {}

    def of_capture(self, capture: str) -> Method:
        """The method for images of one capture."""
        return _OneFace(self, capture)

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Answer:
        """See ``Method``."""
        faces = [self._face(name) for name in subjects]
        normal = torch.from_numpy(np.array([face.normal for face in faces])).permute(0, 3, 1, 2).float()
        pictures = images.permute(0, 2, 3, 1).double().numpy()
        lights = [
            _light(face, picture, mask[0].double().numpy())
            for face, picture, mask in zip(faces, pictures, masks, strict=True)
        ]
        return divided(normal, torch.from_numpy(np.array(lights)).float(), images)

    def _face(self, name: str) -> _Fitted:
        if name not in self._fitted:
            if name not in self.landmarks:
                raise BadInput(f"3dmm: no landmarks of {name!r} are known")
            maps = face_maps(self.model, fit_landmarks(self.model, self.landmarks[name][None]), 0)
            self._fitted[name] = _Fitted(_filled(maps.normal), maps.bare)
        return self._fitted[name]


class _OneFace:
    name = ModelFit.name

    def __init__(self, method: ModelFit, capture: str) -> None:
        self.method, self.capture = method, capture

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Answer:
        return self.method(images, masks, [self.capture] * len(images))


def _filled(normal: Array) -> Array:
    """Normals (H, W, 3), each zero one replaced by the nearest that is none."""
    from scipy.ndimage import distance_transform_edt

    unknown = (normal**2).sum(-1) == 0
    if unknown.all():
        raise BadInput("3dmm: the fitted face lies outside of the picture; are its landmarks right?")
    rows, columns = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return np.asarray(normal[rows, columns])


def _light(face: _Fitted, picture: Array, mask: Array) -> Array:
    """Shading coefficients (27,) of one picture."""
    clear = picture.max(axis=-1) < CLIPPED
    choices = (mask * face.bare * clear, mask * clear, mask)
    shown = next((choice for choice in choices if (choice > 0).sum() >= _FEW), mask)
    grey = float(np.ptp(picture, axis=-1).max()) <= _GREY * float(picture.max())
    albedo = np.full(3, LUMINANCE @ np.array(MEAN_SKIN)) if grey else np.array(MEAN_SKIN)
    return fit_light(face.normal, picture, shown, albedo, robust=False).light.flat()
