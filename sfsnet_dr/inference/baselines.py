"""Baselines: mean normals and albedo of other subjects, a 3DMM fit, and a SIRFS-like search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.estimation.morphable_fit import CLIPPED, face_maps, fit_landmarks
from sfsnet_dr.estimation.sh_lighting import MEAN_SKIN, fit_light
from sfsnet_dr.estimation.sirfs import IntrinsicOptions, solve_intrinsic
from sfsnet_dr.inference.methods import (
    MEAN_ALBEDO,
    Method,
    Prediction,
    albedo_by_division,
    fit_light_and_albedo,
    fit_light_to_images,
)
from sfsnet_dr.render.shading_torch import shading, unit
from sfsnet_dr.scene.faces.linear_model import FaceModes


class MeanNormals:
    """The mean normals of other subjects; the albedo takes what they leave in the image.

    Args:
        normals: subject -> normals (3, 128, 128), 0 where they are not known.

    Raises:
        InputError: with fewer than two subjects.
    """

    name = "mean-face"

    def __init__(self, normals: Mapping[str, Tensor]) -> None:
        self._normals = _Others(normals)

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Prediction:
        """See ``Method``."""
        return fit_light_and_albedo(_ahead(self._normals(subjects)), images, masks)


class OneAlbedo:
    """The mean normals of other subjects, and the same albedo everywhere.

    Args:
        normals: as for ``MeanNormals``.
    """

    name = "one-albedo"

    def __init__(self, normals: Mapping[str, Tensor]) -> None:
        self._normals = _Others(normals)

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Prediction:
        """See ``Method``."""
        albedo = torch.full_like(images[:, :1], MEAN_ALBEDO)
        return _lit(_ahead(self._normals(subjects)), albedo, images, masks)


class MeanAlbedo:
    """The mean normals and the mean albedo of other subjects.

    Args:
        normals: as for ``MeanNormals``.
        albedo: subject -> albedo (1, 128, 128) up to a factor, 0 where it is not known.
    """

    name = "mean-albedo"

    def __init__(self, normals: Mapping[str, Tensor], albedo: Mapping[str, Tensor]) -> None:
        scaled = {name: _scaled(each) for name, each in albedo.items()}
        self._normals, self._albedo = _Others(normals), _Others(scaled)
        self._known = _Others({name: (each > 0).float() for name, each in scaled.items()})

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Prediction:
        """See ``Method``."""
        known = self._known(subjects)
        mean = torch.where(known > 0, self._albedo(subjects) / known.clamp_min(1), MEAN_ALBEDO)
        return _lit(_ahead(self._normals(subjects)), mean, images, masks)


class _Others:
    """The sum of all subjects' maps but for one's own."""

    def __init__(self, maps: Mapping[str, Tensor]) -> None:
        if len(maps) < 2:
            raise InputError(f"subjects: {len(maps)} found, two are needed for the mean of others")
        self._maps = dict(maps)
        self._total = torch.stack(list(self._maps.values())).sum(0)

    def __call__(self, subjects: Sequence[str]) -> Tensor:
        """(B, C, H, W)."""
        own = torch.zeros_like(self._total)
        return torch.stack([self._total - self._maps.get(subject, own) for subject in subjects])


def _ahead(total: Tensor) -> Tensor:
    """Unit normals of a sum, toward the viewer where nobody's are known."""
    return unit(total + total.new_tensor([0, 0, 1e-3])[:, None, None])


def _scaled(albedo: Tensor) -> Tensor:
    """Albedo whose mean, where it is known, is ``MEAN_ALBEDO``."""
    return albedo * (MEAN_ALBEDO * (albedo > 0).sum() / albedo.sum().clamp_min(1e-9))


def _lit(normal: Tensor, albedo: Tensor, images: Tensor, masks: Tensor) -> Prediction:
    light = fit_light_to_images(normal, albedo, images, masks)
    albedo = albedo.expand_as(images)
    return Prediction(normal, albedo, light, albedo * shading(normal, light))


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
        InputError: without landmarks; when called, for a name that has none.
    """

    name = "3dmm"

    def __init__(self, model: FaceModes, landmarks: Mapping[str, Array]) -> None:
        if not landmarks:
            raise InputError("landmarks: none found, those of one face at least are needed")
        self.model, self.landmarks = model, dict(landmarks)
        self._fitted: dict[str, _Fitted] = {}

    def of_capture(self, capture: str) -> Method:
        """The method for images of one capture."""
        return _OneFace(self, capture)

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Prediction:
        """See ``Method``."""
        faces = [self._face(name) for name in subjects]
        normal = torch.from_numpy(np.array([face.normal for face in faces])).permute(0, 3, 1, 2).float()
        pictures = images.permute(0, 2, 3, 1).double().numpy()
        lights = [
            _light(face, picture, mask[0].double().numpy())
            for face, picture, mask in zip(faces, pictures, masks, strict=True)
        ]
        return albedo_by_division(normal, torch.from_numpy(np.array(lights)).float(), images)

    def _face(self, name: str) -> _Fitted:
        if name not in self._fitted:
            if name not in self.landmarks:
                raise InputError(f"3dmm: no landmarks of {name!r} are known")
            maps = face_maps(self.model, fit_landmarks(self.model, self.landmarks[name][None]), 0)
            self._fitted[name] = _Fitted(_filled(maps.normal), maps.bare)
        return self._fitted[name]


class _OneFace:
    name = ModelFit.name

    def __init__(self, method: ModelFit, capture: str) -> None:
        self.method, self.capture = method, capture

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Prediction:
        return self.method(images, masks, [self.capture] * len(images))


def _filled(normal: Array) -> Array:
    """Normals (H, W, 3), each zero one replaced by the nearest that is none."""
    from scipy.ndimage import distance_transform_edt

    unknown = (normal**2).sum(-1) == 0
    if unknown.all():
        raise InputError("3dmm: the fitted face lies outside of the picture; are its landmarks right?")
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


class ShadingSearch:
    """``fit.intrinsic`` as a method; its normals are interpolated to the image's size.

    The light has no tint: what tint there is becomes the albedo's, whose luminance is 0.5 on average.

    Args:
        options: of the optimiser; those found on rendered faces if left out.

    Raises:
        InputError: when called, for an image that is black or a mask that is empty.
    """

    name = "sirfs"

    def __init__(self, options: IntrinsicOptions | None = None) -> None:
        self.options = options or IntrinsicOptions()

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Prediction:
        """See ``Method``."""
        found = solve_intrinsic(images, masks, self.options)
        size = images.shape[-1]
        grown = functional.interpolate(found.normal, (size, size), mode="bilinear", align_corners=False)
        normal = unit(grown)
        shown = (masks * shading(normal, found.light.repeat(1, 3))).clamp_min(0).sum((1, 2, 3)) / 3
        weights = torch.tensor(LUMINANCE, dtype=images.dtype)[None, :, None, None]
        bright = (masks * images * weights).sum((1, 2, 3))
        level = bright / (0.5 * shown.clamp_min(1e-6))
        return albedo_by_division(normal, (found.light * level[:, None]).repeat(1, 3), images)
