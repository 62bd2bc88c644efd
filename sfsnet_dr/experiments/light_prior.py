"""The light prior of a folder of photographs: fits, mixture, numbers, and overlays to look at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.color import linear_to_srgb, srgb_to_linear
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.image_io import write_png
from sfsnet_dr.data.alignment import canonical_landmarks
from sfsnet_dr.data.photos import Photo, list_photos, load_photos
from sfsnet_dr.estimation.light_prior import choose_components, fit_photographs, learn_mixture, usable_fits
from sfsnet_dr.estimation.morphable_fit import FaceFit, fit_face
from sfsnet_dr.estimation.sh_lighting import MEAN_SKIN
from sfsnet_dr.scene.faces.linear_model import FaceModes
from sfsnet_dr.scene.lights.photo_prior import VISIBLE, lights_visibly, write_mixture

Array = npt.NDArray[np.float64]

_COMPONENTS: Final = (1, 2, 3, 4, 6, 8, 12)
#: Photographs on the sheet of overlays.
_SHOWN: Final = 12


@dataclass(frozen=True)
class FitLightsOptions:
    """What the command line says; see ``commands.light_prior``."""

    most: int | None = None
    components: int | None = None
    draws: int = 20000
    seed: int = 0

    def __post_init__(self) -> None:
        for name, value in (("most", self.most), ("components", self.components), ("draws", self.draws)):
            if value is not None and value < 1:
                raise InputError(f"{name}: {value} found, 1 at least is needed")


@dataclass(frozen=True)
class LightPriorResult:
    """Numbers with their units by name, and the photographs that were skipped, with reasons."""

    numbers: dict[str, tuple[float, str]]
    skipped: dict[str, str]


def fit_lights(
    photographs: Path | str,
    model: FaceModes,
    out: Path,
    options: FitLightsOptions,
    on_photo: Callable[[], object] = lambda: None,
) -> LightPriorResult:
    """Fit every photograph, learn the mixture, draw from it; writes fits, mixture and overlays into ``out``.

    Raises:
        InputError: for unusable photographs, or too few of them for a mixture.
    """
    every = fit_photographs(photographs, model, out, most=options.most, seed=options.seed, on_photo=on_photo)
    counts = _COMPONENTS if options.components is None else (options.components,)
    mixture = learn_mixture(every.fits, counts, options.seed, {"skipped": len(every.skipped)})
    drawn = mixture.draw(np.random.default_rng([options.seed, 1]), options.draws)
    rejected = 1 - float(lights_visibly(drawn).mean())
    source = dict(mixture.source) | {"rejected_share": round(rejected, 4), "rejected_degrees": VISIBLE}
    write_mixture(out / "mixture.json", type(mixture)(mixture.shares, mixture.means, mixture.factors, source))
    chosen = choose_components(list_photos(photographs)[0], options.most, options.seed)
    done = {fit.name for fit in every.fits}
    write_png(out / "overlays.png", overlays([photo for photo in chosen if photo.name in done], model))
    residuals = [fit.residual for fit in every.fits]
    numbers = {
        "photographs": (float(len(every.fits)), "photographs"),
        "skipped": (float(len(every.skipped)), "photographs"),
        "used": (float(len(usable_fits(every.fits))), "photographs"),
        "landmarks.mean_px": (float(np.mean([fit.landmark_error for fit in every.fits])), "pixel"),
        "residual.median": (float(np.median(residuals)), "1"),
        "residual.p90": (float(np.quantile(residuals, 0.9)), "1"),
        "seconds_per_photograph": (float(np.median([fit.seconds for fit in every.fits])), "s"),
        "mixture.components": (float(len(mixture.shares)), "components"),
        "mixture.rejected": (rejected, "1"),
    }
    return LightPriorResult(numbers, every.skipped)


def overlays(photos: list[Photo], model: FaceModes, count: int = _SHOWN) -> Array:
    """A sheet (5 * 128, N * 128, 3), linear, of photographs spread over the list.

    From the top: photograph, fitted normals, both with the landmarks in red, fitted shading on mean skin, and
    how far the light's fit trusts each pixel.
    """
    picked = [
        photos[k] for k in np.unique(np.linspace(0, len(photos) - 1, min(count, len(photos))).astype(int))
    ]
    read = load_photos(picked)
    columns = []
    for index, name in enumerate(read.names):
        points = canonical_landmarks(next(photo.points for photo in picked if photo.name == name))
        image = np.asarray(srgb_to_linear(np.moveaxis(read.images[index].numpy(), 0, -1) / 255.0))
        shown = read.masks[index, 0].numpy() / 255.0
        columns.append(_column(image, points, fit_face(image, points, model, shown)))
    return np.concatenate(columns, axis=1)


def _column(image: Array, points: Array, fit: FaceFit) -> Array:
    face = (fit.mask > 0)[..., None]
    normal = srgb_to_linear((fit.normal + 1) / 2 * face)
    mixed = srgb_to_linear(
        np.where(face, 0.5, 1.0) * linear_to_srgb(image) + 0.5 * linear_to_srgb(normal) * face
    )
    column, row = np.clip(points.astype(int), 0, len(image) - 1).T
    mixed[row, column] = (1.0, 0.0, 0.0)
    shading = np.clip(fit.light.evaluate(fit.normal) * MEAN_SKIN, 0, 1) * face
    trust = np.repeat(srgb_to_linear(fit.weights)[..., None], 3, axis=2)
    return np.concatenate([image, normal, mixed, shading, trust], axis=0)
