"""Run one method on photographs and keep the errors of each, over the face and by region."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from scipy.ndimage import binary_fill_holes, distance_transform_edt

from sfsnet_dr.core.color import delta_e_2000
from sfsnet_dr.core.conventions import EYE_DISTANCE, EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT, FACE_SIZE
from sfsnet_dr.core.errors import RunError
from sfsnet_dr.experiments.evaluation.samples import EvaluationSample
from sfsnet_dr.inference.methods import Method, PerImageSet, Prediction, method_for_image_set
from sfsnet_dr.metrics.image import mae_8bit, rmse_8bit
from sfsnet_dr.metrics.light import light_direction
from sfsnet_dr.metrics.normals import angles_deg

Mask = npt.NDArray[np.bool_]

REGIONS: Final = ("forehead", "eyes", "nose", "cheeks", "mouth and chin", "outline")

#: Bounds in distances between the eyes, from the point between them: x to either side, y downward.
_BROWS: Final = -0.27
_BELOW_EYES: Final = 0.25
_BELOW_NOSE: Final = 0.83
_BRIDGE: Final = 0.18
_NOSE: Final = 0.32
_MOUTH: Final = 0.58
#: Width of the outline in shares of the frame.
_RIM: Final = 5 / 128


def face_regions(mask: npt.ArrayLike) -> dict[str, Mask]:
    """Which pixels of a mask (H, W) belong to which region; each belongs to one.

    Everybody's eyes are at the same places in this frame, so lines at fixed distances from them divide an
    upright face: brows and eyes with the lids; the nose with its bridge; mouth and chin between the corners
    of the mouth. The outline is what lies within 4 % of the frame's width of the mask's outer end, be it the
    face's or the photograph's, and is taken first.
    """
    skin = np.asarray(mask) > 0.5
    size = skin.shape[0]
    place = (np.arange(size) + 0.5) * FACE_SIZE / size
    middle = (EYE_IMAGE_LEFT[0] + EYE_IMAGE_RIGHT[0]) / 2
    x = np.abs(place - middle)[None, :] / EYE_DISTANCE + np.zeros((size, 1))
    y = (place - EYE_IMAGE_LEFT[1])[:, None] / EYE_DISTANCE + np.zeros((1, size))
    whole = np.pad(binary_fill_holes(skin), 1)
    rim = distance_transform_edt(whole)[1:-1, 1:-1] <= _RIM * size
    nose = (y >= _BROWS) & (y < _BELOW_NOSE) & (x < np.where(y < _BELOW_EYES, _BRIDGE, _NOSE))
    parts = {
        "forehead": y < _BROWS,
        "eyes": (y >= _BROWS) & (y < _BELOW_EYES) & ~nose,
        "nose": nose,
        "mouth and chin": (y >= _BELOW_NOSE) & (x < _MOUTH),
    }
    rest = ~np.any(list(parts.values()), axis=0)
    found = {name: part & skin & ~rim for name, part in (parts | {"cheeks": rest}).items()}
    found["outline"] = skin & rim
    return {name: found[name] for name in REGIONS}


Array = npt.NDArray[np.float64]

LIMITS: Final = (20.0, 25.0, 30.0)
BATCH: Final = 16


@dataclass(frozen=True)
class ImageErrors:
    """Errors of one photograph; None where its truth is not known or the number would mean nothing.

    Attributes:
        shot: which.
        coefficients: estimated shading coefficients, 27.
        normals: see ``NormalSums``.
        albedo: RMS error relative to the true albedo's RMS, after the best factor.
        albedo_confident: the same where the truth is sure, which leaves out brows, lips, beards and folds.
        mae, rmse: of the reconstruction, 8-bit sRGB units.
        delta_e: mean Delta E 2000 of the reconstruction; of colour photographs only.
        light: length of the error of the light's coefficients relative to theirs, after the best factor.
        light_deg: angle between the estimated and the true direction of light.
    """

    shot: EvaluationSample = field(repr=False)
    coefficients: Array = field(repr=False)
    normals: NormalSums | None = None
    albedo: float | None = None
    albedo_confident: float | None = None
    mae: float | None = None
    rmse: float | None = None
    delta_e: float | None = None
    light: float | None = None
    light_deg: float | None = None


@dataclass(frozen=True, eq=False)
class NormalSums:
    """Sums over the pixels of one photograph, from which those of many are pooled.

    Attributes:
        all: number of pixels, sum of the angular errors (degrees), sum of their squares, and the number of
            pixels below each of ``LIMITS``, (6,).
        regions: number of pixels and sum of errors of each of ``REGIONS``, (6, 2).
    """

    all: Array
    regions: Array

    @property
    def mean(self) -> float:
        """Mean error of the photograph, degrees."""
        return float(self.all[1] / self.all[0])


@dataclass(frozen=True)
class MethodErrors:
    """A method's errors, and how many photographs a second it answers."""

    method: str
    images: list[ImageErrors]
    images_per_s: float


def run_method(method: Method, shots: Sequence[EvaluationSample]) -> Prediction:
    """A method's answer for some photographs of one size."""
    if isinstance(method, PerImageSet):
        return _joined([_answer(method_for_image_set(method, shot.capture), [shot]) for shot in shots])
    return _answer(method, shots)


def _answer(method: Method, shots: Sequence[EvaluationSample]) -> Prediction:
    images, masks = (torch.stack([getattr(shot, name) for shot in shots]) for name in ("image", "mask"))
    with torch.no_grad():
        return method(images, masks, [shot.subject for shot in shots])


def _joined(parts: Sequence[Prediction]) -> Prediction:
    return Prediction(
        torch.cat([part.normal for part in parts]),
        torch.cat([part.albedo for part in parts]),
        torch.cat([part.light for part in parts]),
        torch.cat([part.image for part in parts]),
        all(part.divided for part in parts),
    )


def measure_methods(
    method: Method, shots: Sequence[EvaluationSample], on_batch: Callable[[int], object] = lambda count: None
) -> MethodErrors:
    """Put every photograph to a method.

    Args:
        method: which.
        shots: with their truth.
        on_batch: called with the number of photographs after each batch.

    Returns:
        The errors in the order of the photographs. Time counts the method's own work, after a first call
        that prepares it.

    Raises:
        RunError: if an answer is not finite.
    """
    found, seconds = [], 0.0
    run_method(method, shots[:1])
    for begin in range(0, len(shots), BATCH):
        part = shots[begin : begin + BATCH]
        start = time.perf_counter()
        answer = run_method(method, part)
        seconds += time.perf_counter() - start
        found += [_errors(method.name, shot, answer, index) for index, shot in enumerate(part)]
        on_batch(len(part))
    return MethodErrors(method.name, found, len(found) / max(seconds, 1e-9))


def _errors(method: str, shot: EvaluationSample, answer: Prediction, index: int) -> ImageErrors:
    mask = shot.mask[0].numpy() > 0.5
    normal, albedo, image = (
        _pixels(part[index], mask) for part in (answer.normal, answer.albedo, answer.image)
    )
    light = answer.light[index].double().numpy()
    if not all(np.isfinite(part).all() for part in (normal, albedo, image, light)):
        raise RunError(f"{method}: its answer for {shot.name} is not finite")
    true = _pixels(shot.image, mask)
    drawn = image[:, None], true[:, None]
    direction = shot.direction
    if direction is None and shot.coefficients is not None:
        direction = light_direction(shot.coefficients[None])[0]
    tells = not answer.divided
    return ImageErrors(
        shot=shot,
        coefficients=light,
        normals=None if shot.normal is None else _sums(normal, shot, mask),
        albedo=None if shot.albedo is None else scaled_rms(albedo, _pixels(shot.albedo, mask)),
        albedo_confident=_confident_error(albedo, shot, mask),
        mae=mae_8bit(*drawn) if tells else None,
        rmse=rmse_8bit(*drawn) if tells else None,
        delta_e=float(delta_e_2000(np.clip(image, 0, 1), true).mean()) if tells and not shot.grey else None,
        light=None if shot.coefficients is None else scaled_rms(light, shot.coefficients),
        light_deg=None
        if direction is None
        else float(angles_deg(light_direction(light[None]), direction[None])[0]),
    )


def _confident_error(albedo: Array, shot: EvaluationSample, mask: npt.NDArray[np.bool_]) -> float | None:
    if shot.albedo is None or shot.sure is None or not (shot.sure & mask).any():
        return None
    return scaled_rms(albedo[shot.sure[mask]], _pixels(shot.albedo, mask & shot.sure))


def _sums(normal: Array, shot: EvaluationSample, mask: npt.NDArray[np.bool_]) -> NormalSums:
    assert shot.normal is not None
    angles = angles_deg(normal, _pixels(shot.normal, mask))
    below = [float((angles < limit).sum()) for limit in LIMITS]
    regions = face_regions(mask)
    parts = [angles[regions[name][mask]] for name in REGIONS]
    return NormalSums(
        np.array([len(angles), angles.sum(), (angles**2).sum(), *below]),
        np.array([[len(part), part.sum()] for part in parts], np.float64),
    )


def scaled_rms(found: Array, true: Array) -> float:
    """RMS of s * found - true over the RMS of true, with the best factor s; 1 where found is 0."""
    power = float((found * found).sum())
    factor = float((found * true).sum()) / power if power > 0 else 0.0
    return float(np.sqrt(((factor * found - true) ** 2).sum() / max(float((true * true).sum()), 1e-12)))


def _pixels(planes: torch.Tensor, mask: npt.NDArray[np.bool_]) -> Array:
    return np.asarray(planes.double().numpy()[:, mask].T)
