"""One method on faces with known normals, albedo and lights: what is kept of every image."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt
import torch

from sfsnet_dr.apply.methods import Answer, Method, for_capture
from sfsnet_dr.data.surface_labels import SurfaceLabels
from sfsnet_dr.metrics.image import mae_8bit, rmse_8bit
from sfsnet_dr.metrics.light_classes import light_direction
from sfsnet_dr.metrics.normals import angles_deg

Array = npt.NDArray[np.float64]

LIMITS: Final = (20.0, 25.0, 30.0)
BATCH: Final = 16


@dataclass(frozen=True)
class ImageErrors:
    """Errors of one image.

    Attributes:
        subject, light: whom it shows, and the name of its light.
        angle: of the light from the viewer's direction, degrees.
        pixels: number of pixels whose normals count.
        total, squares: sum of the normals' angular errors (degrees) and of their squares.
        below: number of pixels below each of ``LIMITS``.
        albedo: RMS error relative to the true albedo's RMS, after the best factor.
        mae, rmse: of the reconstruction, 8-bit sRGB units.
        light_deg: angle between the estimated and the true direction of light.
        coefficients: estimated shading coefficients, 27.
    """

    subject: str
    light: str
    angle: float
    pixels: int
    total: float
    squares: float
    below: tuple[int, int, int]
    albedo: float
    mae: float
    rmse: float
    light_deg: float
    coefficients: Array = field(repr=False)


@dataclass(frozen=True)
class Measured:
    """A method's errors, and how many images a second it answers."""

    method: str
    images: list[ImageErrors]
    images_per_s: float


def measure(
    method: Method,
    faces: Sequence[SurfaceLabels],
    lights: Sequence[str] | None = None,
    on_batch: Callable[[], object] = lambda: None,
) -> Measured:
    """Put every image to a method.

    Args:
        method: which.
        faces: with their truth.
        lights: names of those that take part; all if not given.
        on_batch: called after each batch of a face.

    Returns:
        The errors in the order of faces and lights. Time counts the method's own work.
    """
    found, seconds = [], 0.0
    for face in faces:
        chosen = [j for j, name in enumerate(face.lights) if lights is None or name in lights]
        for begin in range(0, len(chosen), BATCH):
            rows = chosen[begin : begin + BATCH]
            images = face.images[rows]
            masks = face.mask[None].expand(len(rows), -1, -1, -1)
            start = time.perf_counter()
            with torch.no_grad():
                answer = for_capture(method, face.name)(images, masks, [face.subject] * len(rows))
            seconds += time.perf_counter() - start
            found += [_errors(face, j, answer, index) for index, j in enumerate(rows)]
            on_batch()
    return Measured(method.name, found, len(found) / max(seconds, 1e-9))


def _errors(face: SurfaceLabels, row: int, answer: Answer, index: int) -> ImageErrors:
    mask = face.mask[0].numpy() > 0.5
    angles = angles_deg(_pixels(answer.normal[index], mask), _pixels(face.normal, mask))
    image = np.moveaxis(face.images[row].double().numpy(), 0, -1)
    drawn = np.moveaxis(np.nan_to_num(answer.image[index].double().numpy()), 0, -1)
    light = answer.light[index].double().numpy()
    direction = face.direction[row].double().numpy()
    below = tuple(int((angles < limit).sum()) for limit in LIMITS)
    return ImageErrors(
        subject=face.subject,
        light=face.lights[row],
        angle=float(angles_deg(direction, [0, 0, 1])),
        pixels=len(angles),
        total=float(angles.sum()),
        squares=float((angles**2).sum()),
        below=(below[0], below[1], below[2]),
        albedo=scaled_rms(_pixels(answer.albedo[index], mask), _pixels(face.albedo.expand(3, -1, -1), mask)),
        mae=mae_8bit(drawn, image, mask),
        rmse=rmse_8bit(drawn, image, mask),
        light_deg=float(angles_deg(light_direction(light), direction)[0]),
        coefficients=light,
    )


def scaled_rms(found: Array, true: Array) -> float:
    """RMS of s * found - true over the RMS of true, with the best factor s; 1 where found is 0."""
    power = float((found * found).sum())
    factor = float((found * true).sum()) / power if power > 0 else 0.0
    return float(np.sqrt(((factor * found - true) ** 2).sum() / (true * true).sum()))


def _pixels(planes: torch.Tensor, mask: npt.NDArray[np.bool_]) -> Array:
    return np.asarray(planes.double().numpy()[:, mask].T)
