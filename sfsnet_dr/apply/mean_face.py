"""What other people's faces look like on average, as answers to any photograph of an aligned face."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from sfsnet_dr.apply.methods import MEAN_ALBEDO, Answer, explained, fitted_light
from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.render.shading_torch import shading, unit


class MeanNormals:
    """The mean normals of other subjects; the albedo takes what they leave in the image.

    Args:
        normals: subject -> normals (3, 128, 128), 0 where they are not known.

    Raises:
        BadInput: with fewer than two subjects.
    """

    name = "mean-face"

    def __init__(self, normals: Mapping[str, Tensor]) -> None:
        self._normals = _Others(normals)

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Answer:
        """See ``Method``."""
        return explained(_ahead(self._normals(subjects)), images, masks)


class OneAlbedo:
    """The mean normals of other subjects, and the same albedo everywhere.

    Args:
        normals: as for ``MeanNormals``.
    """

    name = "one-albedo"

    def __init__(self, normals: Mapping[str, Tensor]) -> None:
        self._normals = _Others(normals)

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Answer:
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

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Answer:
        """See ``Method``."""
        known = self._known(subjects)
        mean = torch.where(known > 0, self._albedo(subjects) / known.clamp_min(1), MEAN_ALBEDO)
        return _lit(_ahead(self._normals(subjects)), mean, images, masks)


class _Others:
    """The sum of all subjects' maps but for one's own."""

    def __init__(self, maps: Mapping[str, Tensor]) -> None:
        if len(maps) < 2:
            raise BadInput(f"subjects: {len(maps)} found, two are needed for the mean of others")
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


def _lit(normal: Tensor, albedo: Tensor, images: Tensor, masks: Tensor) -> Answer:
    light = fitted_light(normal, albedo, images, masks)
    albedo = albedo.expand_as(images)
    return Answer(normal, albedo, light, albedo * shading(normal, light))
