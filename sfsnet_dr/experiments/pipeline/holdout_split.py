"""Errors of networks on data that none of them was trained on: rendered faces with their truth, photographs.

A number of a set is the mean over its images of the number of an image, so that large faces count no more
than small ones, and its interval is a 95 % bootstrap interval over the images.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from sfsnet_dr.core.color_torch import linear_to_srgb
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.dataset import Faces, RelitFaces
from sfsnet_dr.data.photos import PhotoSet
from sfsnet_dr.data.pseudo_labels import Encoding, as_network_input
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.metrics.bootstrap import bootstrap_interval
from sfsnet_dr.metrics.normals import angular_error_deg
from sfsnet_dr.models.base import NetworkOutput
from sfsnet_dr.models.inference import LoadedModel, predict_with_flip_tta
from sfsnet_dr.render.shading_torch import f_render
from sfsnet_dr.report.record import Record, make_record
from sfsnet_dr.scene.lights.cache import draw_lights

Numbers = dict[str, NDArray[np.float64]]

#: Seed and number of the lights of measuring, apart from those of training.
_SEED: Final = 5_000_011
_LIGHTS: Final = 256

#: Units by the end of a number's name.
UNITS: Final = {
    "normals.mean_deg": "degrees",
    "normals.below20": "%",
    "normals.below30": "%",
    "albedo.mae": "1",
    "albedo.mae_scaled": "1",
    "light.relative": "1",
    "recon.mae": "8-bit sRGB",
    "recon.rmse": "8-bit sRGB",
}


def holdout_batch(faces: Faces, augmentation: Augmentation, count: int) -> FaceBatch:
    """``count`` photographs of held-back faces, the same for every network, each face as often as another."""
    return holdout_faces(faces, augmentation, count).batch(0)


def holdout_faces(faces: Faces, augmentation: Augmentation, count: int) -> RelitFaces:
    """The sequence whose batch 0 ``holdout_batch`` is, and whose ``indices(0)`` say which face each shows."""
    bank = draw_lights(augmentation.light, min(_LIGHTS, augmentation.num_lights), _SEED)
    return RelitFaces(faces, count, augmentation, _SEED, bank)


def rendered_errors(trained: LoadedModel, truth: FaceBatch) -> Numbers:
    """Errors of each image against its truth, on the mask.

    ``normals``: mean angle, and the share of pixels below 20 and 30 degrees. ``albedo.mae``: mean absolute
    error, and ``mae_scaled`` after the best factor for each image, which no photograph tells from the light's
    strength. ``light.relative``: length of the error of the 27 coefficients over that of the coefficients.
    ``recon``: see ``photograph_errors``.
    """
    answer = predict_with_flip_tta(trained.model, truth.image)
    rows = [_truth_errors(answer, truth, index) for index in range(len(truth.image))]
    numbers = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return numbers | reconstruction_errors(answer, truth.image, truth.mask, trained.encoding)


def photograph_errors(trained: LoadedModel, photographs: PhotoSet) -> Numbers:
    """``recon.mae`` and ``recon.rmse`` of each photograph, 8-bit sRGB units on its mask."""
    image = as_network_input(photographs.images, trained.encoding)
    answer = predict_with_flip_tta(trained.model, image)
    return reconstruction_errors(answer, image, photographs.masks.float() / 255, trained.encoding)


def reconstruction_errors(answer: NetworkOutput, image: Tensor, mask: Tensor, values: Encoding) -> Numbers:
    """Mean absolute and root-mean-square difference of reconstructions and images, one number an image.

    Both are clipped to [0, 1] and encoded, or left as they are where values are display-referred; they are
    not rounded. Units of 1/255.
    """
    shown = [part.clamp(0, 1) for part in (f_render(*answer), image)]
    if values == "linear":
        shown = [linear_to_srgb(part) for part in shown]
    difference = 255 * (shown[0] - shown[1]).double()
    count = (3 * mask.double().sum((1, 2, 3))).clamp_min(1e-9)
    mae = (mask * difference.abs()).sum((1, 2, 3)) / count
    rmse = ((mask * difference.square()).sum((1, 2, 3)) / count).sqrt()
    return {"recon.mae": mae.numpy(), "recon.rmse": rmse.numpy()}


def error_records(numbers: Numbers, of: str, network: str, command: str) -> list[Record]:
    """``OF.NAME.NETWORK`` for each number."""
    return [
        make_record(
            f"{of}.{name}.{network}",
            float(values.mean()),
            UNITS[name],
            command=command,
            interval=bootstrap_interval(values) if len(values) > 1 else None,
            seed=_SEED,
        )
        for name, values in numbers.items()
    ]


def _truth_errors(answer: NetworkOutput, truth: FaceBatch, index: int) -> dict[str, float]:
    mask = truth.mask[index, 0]
    found, true = (part[index].permute(1, 2, 0).numpy() for part in (answer.normal, truth.normal))
    normals = angular_error_deg(found, true, mask.numpy())
    albedo, wanted = answer.albedo[index], truth.albedo[index]
    factor = (mask * albedo * wanted).sum() / (mask * albedo.square()).sum().clamp_min(1e-12)
    light, wanted_light = answer.light[index], truth.light[index]
    return {
        "normals.mean_deg": normals.mean,
        "normals.below20": normals.below20,
        "normals.below30": normals.below30,
        "albedo.mae": _masked_mean((albedo - wanted).abs(), mask),
        "albedo.mae_scaled": _masked_mean((factor * albedo - wanted).abs(), mask),
        "light.relative": float(
            torch.linalg.vector_norm(light - wanted_light) / torch.linalg.vector_norm(wanted_light)
        ),
    }


def _masked_mean(values: Tensor, mask: Tensor) -> float:
    return float((mask * values).sum() / (len(values) * mask.sum()).clamp_min(1e-9))


def find_record(records: Sequence[Record], what: str) -> Record | None:
    """The record of a name, if there is one."""
    return next((record for record in records if record.what == what), None)
