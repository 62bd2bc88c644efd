"""Fit the lights of photographs with a face model, and a Gaussian mixture over all of them (EM).

Fits are kept line by line in ``fits.jsonl``, so that a stopped run goes on. The mixture is over lights of
equal level and, on average, without tint: an exposure and the colour of a skin cannot be told from the light,
and a camera's exposure and white balance are drawn when a light is used.

Written out because it is forty lines, and a learning library would be a dependency for one command. Source:
Bishop, Pattern Recognition and Machine Learning (2006), section 9.2.2; starts as k-means++ does.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.color import LUMINANCE, srgb_to_linear
from sfsnet_dr.core.conventions import LIGHT_SIZE
from sfsnet_dr.core.errors import InputError, RunError, check_shape
from sfsnet_dr.core.files import output_dir
from sfsnet_dr.data.alignment import canonical_landmarks
from sfsnet_dr.data.photos import Photo, list_photos, load_photos
from sfsnet_dr.estimation.morphable_fit import explain_by_light, fit_landmarks
from sfsnet_dr.estimation.sh_lighting import MEAN_SKIN, RIDGE
from sfsnet_dr.scene.faces.linear_model import FaceModes
from sfsnet_dr.scene.lights.light import face_normals
from sfsnet_dr.scene.lights.photo_prior import LightMixture
from sfsnet_dr.sh.basis import sh_basis

Array = npt.NDArray[np.float64]

_ROUNDS: Final = 200
_CLOSE_ENOUGH: Final = 1e-5


@dataclass(frozen=True, eq=False)
class GaussianMixture:
    """K normal distributions in D dimensions.

    Attributes:
        shares: (K,).
        means: (K, D).
        factors: lower triangular roots of the covariances, (K, D, D).
        likelihood: mean log-likelihood of the data in each round.
    """

    shares: Array
    means: Array
    factors: Array
    likelihood: tuple[float, ...]

    def log_likelihood(self, rows: Array) -> Array:
        """Logarithm of the density at rows (N, D), (N,)."""
        return _total(_weighted_logs(rows, self.shares, self.means, self.factors))


def fit_mixture(rows: Array, components: int, seed: int = 0, floor: float = 1e-4) -> GaussianMixture:
    """Fit a mixture with full covariances.

    Args:
        rows: (N, D), N above components * D.
        components: K.
        seed: of the start.
        floor: variance that is added to every component along every axis.

    Raises:
        InputError: for too few rows, or rows that are not finite.
    """
    sizes = check_shape("rows", rows, "N D")
    if sizes["N"] <= components * sizes["D"] or not np.isfinite(rows).all():
        raise InputError(
            f"mixture: {sizes['N']} finite rows found, more than {components * sizes['D']} are needed "
            f"for {components} components in {sizes['D']} dimensions"
        )
    belonging = _start(rows, components, np.random.default_rng(seed))
    told: list[float] = []
    while True:
        shares, means, factors = _maximise(rows, belonging, floor)
        logs = _weighted_logs(rows, shares, means, factors)
        total = _total(logs)
        told.append(float(total.mean()))
        if len(told) >= _ROUNDS or (len(told) > 1 and told[-1] - told[-2] < _CLOSE_ENOUGH):
            return GaussianMixture(shares, means, factors, tuple(told))
        belonging = np.exp(logs - total[:, None])


def _start(rows: Array, components: int, rng: np.random.Generator) -> Array:
    """Rows belong to the clusters of k-means, (N, K)."""
    from scipy.cluster.vq import kmeans2

    scaled = rows / np.maximum(rows.std(axis=0), 1e-12)
    label = kmeans2(scaled, components, iter=20, minit="++", rng=rng)[1]
    return np.asarray(label[:, None] == np.arange(components), np.float64)


def _weighted_logs(rows: Array, shares: Array, means: Array, factors: Array) -> Array:
    parts = [_log_density(rows, *part) for part in zip(means, factors, strict=True)]
    return np.asarray(np.log(shares) + np.stack(parts, axis=1))


def _total(logs: Array) -> Array:
    top = logs.max(axis=1, keepdims=True)
    return np.asarray(top[:, 0] + np.log(np.exp(logs - top).sum(axis=1)))


def _maximise(rows: Array, belonging: Array, floor: float) -> tuple[Array, Array, Array]:
    count = belonging.sum(axis=0) + 1e-9
    means = belonging.T @ rows / count[:, None]
    factors = []
    for k, mean in enumerate(means):
        apart = rows - mean
        spread = (apart * belonging[:, k : k + 1]).T @ apart / count[k]
        factors.append(np.linalg.cholesky(spread + floor * np.eye(rows.shape[1])))
    return count / count.sum(), means, np.array(factors)


def _log_density(rows: Array, mean: Array, factor: Array) -> Array:
    from scipy.linalg import solve_triangular

    white = solve_triangular(factor, (rows - mean).T, lower=True)
    size = len(mean)
    return np.asarray(
        -0.5 * ((white**2).sum(axis=0) + size * np.log(2 * np.pi)) - np.log(np.diag(factor)).sum()
    )


FITS: Final = "fits.jsonl"
_FORMAT: Final = "sfsnet_dr.fits.1"
_BATCH: Final = 32
#: Mean difference of a pixel's colours, as a share of its brightness, below which a photograph is grey.
_GREY: Final = 0.03
#: Photographs for each component and number that a mixture is tried with.
_ROWS: Final = 4
#: Relative residual above which a fit says nothing of the light.
_WORST: Final = 0.5


@dataclass(frozen=True, eq=False)
class PhotographFit:
    """One photograph's fit.

    Attributes:
        name: of the photograph.
        light: shading coefficients (27,) under a mean skin's albedo.
        residual: of the light, relative (``fit.light_fit``).
        landmark_error: canonical pixels.
        grey: whether the photograph has no colour.
        seconds: what reading and fitting took.
    """

    name: str
    light: Array
    residual: float
    landmark_error: float
    grey: bool
    seconds: float


@dataclass(frozen=True, eq=False)
class PhotographFits:
    """All fits of a folder, and the photographs that could not be used, with reasons."""

    fits: tuple[PhotographFit, ...]
    skipped: dict[str, str]


def fit_photographs(
    photographs: Path | str,
    model: FaceModes,
    out: Path | str,
    *,
    most: int | None = None,
    seed: int = 0,
    on_photo: Callable[[], object] = lambda: None,
) -> PhotographFits:
    """Fit face and light of each photograph of a folder; go on where an earlier call was stopped.

    Args:
        photographs: see ``data.photo_set``.
        model: the face model.
        out: folder for ``fits.jsonl``; made if missing.
        most: take no more than these many, drawn by the seed.
        seed: see ``most``.
        on_photo: called for each photograph that is done.

    Raises:
        InputError: for a folder without photographs or landmarks, or an ``out`` with another model's fits.
        RunError: if no photograph could be fitted.
    """
    listed, skipped = list_photos(photographs)
    chosen = choose_components(listed, most, seed)
    kept = _Kept(output_dir(out) / FITS, {"format": _FORMAT, "model": model.digest, "ridge": RIDGE})
    todo = []
    for photo in chosen:
        if photo.name in kept.done:
            on_photo()
        else:
            todo.append(photo)
    for begin in range(0, len(todo), _BATCH):
        kept.add(_fit_batch(todo[begin : begin + _BATCH], model, on_photo))
    names = {photo.name for photo in chosen}
    reasons = {item.name: item.reason for item in skipped}
    reasons |= {name: told for name, told in kept.skipped.items() if name in names}
    fits = tuple(fit for name, fit in sorted(kept.done.items()) if fit is not None and name in names)
    if not fits:
        raise RunError(f"{photographs}: none of {len(chosen)} photographs could be fitted; see {kept.path}")
    return PhotographFits(fits, reasons)


def choose_components(photos: Sequence[Photo], most: int | None, seed: int) -> list[Photo]:
    """Up to ``most`` photographs, in the order of their names."""
    if most is None or most >= len(photos):
        return list(photos)
    if most < 1:
        raise InputError(f"--max-images: {most} found, at least 1 is needed")
    picked = np.random.default_rng(seed).permutation(len(photos))[:most]
    return [photos[index] for index in sorted(picked)]


def learn_mixture(
    fits: Sequence[PhotographFit], components: Sequence[int], seed: int, source: dict[str, Any]
) -> LightMixture:
    """A mixture over the lights of photographs with colour.

    Of several numbers of components the one is taken that, learnt on four fifths of the photographs, makes
    the rest most likely.

    Raises:
        InputError: if too few photographs are left for the smallest number.
    """
    used = usable_fits(fits)
    lights = normalise_exposure(np.array([fit.light for fit in used]).reshape(-1, LIGHT_SIZE))
    order = np.random.default_rng([seed, 3]).permutation(len(lights))
    train, held = lights[order[len(order) // 5 :]], lights[order[: len(order) // 5]]
    tried = [k for k in components if k == min(components) or len(train) > _ROWS * k * LIGHT_SIZE]
    chosen = tried[0]
    if len(tried) > 1:
        chosen = max(tried, key=lambda k: float(fit_mixture(train, k, seed).log_likelihood(held).mean()))
    best = fit_mixture(lights, chosen, seed)
    told = {
        "photographs": len(used),
        "left_out_grey": sum(fit.grey for fit in fits),
        "left_out_residual": sum(not fit.grey and fit.residual > _WORST for fit in fits),
        "residual_median": round(float(np.median([fit.residual for fit in used])), 4),
        "residual_p90": round(float(np.quantile([fit.residual for fit in used], 0.9)), 4),
        "landmark_error_px": round(float(np.mean([fit.landmark_error for fit in used])), 3),
        "albedo": list(MEAN_SKIN),
    }
    return LightMixture(best.shares, best.means, best.factors, source | told)


def usable_fits(fits: Sequence[PhotographFit]) -> list[PhotographFit]:
    """Those that say something of a light and its colour."""
    return [fit for fit in fits if not fit.grey and fit.residual <= _WORST and (_levels(fit.light) > 0).all()]


def normalise_exposure(lights: Array) -> Array:
    """Lights (N, 27) of level 1 whose median tint is white.

    The level is the luminance of the mean shading of a face (``scene.lights.face_normals``).
    """
    tints = np.log(_levels(lights))
    white = np.exp(np.median(tints - tints.mean(axis=1, keepdims=True), axis=0))
    balanced = (lights.reshape(len(lights), 3, -1) / white[:, None]).reshape(len(lights), -1)
    return np.asarray(balanced / (_levels(balanced) @ LUMINANCE)[:, None])


def _levels(lights: Array) -> Array:
    """Mean shading (..., 3) of a face under lights (..., 27)."""
    mean = sh_basis(face_normals(), 2).mean(axis=0)
    return np.asarray(lights.reshape(*lights.shape[:-1], 3, -1) @ mean)


def _fit_batch(
    photos: Sequence[Photo], model: FaceModes, on_photo: Callable[[], object]
) -> list[tuple[str, PhotographFit | str]]:
    begin = time.perf_counter()
    read = load_photos(photos)
    results: list[tuple[str, PhotographFit | str]] = [(item.name, item.reason) for item in read.skipped]
    for _ in read.skipped:
        on_photo()
    if not len(read):
        return results
    points = {photo.name: canonical_landmarks(photo.points) for photo in photos}
    placement = fit_landmarks(model, np.stack([points[name] for name in read.names]))
    shared = (time.perf_counter() - begin) / len(photos)
    for index, name in enumerate(read.names):
        begin = time.perf_counter()
        image = np.asarray(srgb_to_linear(np.moveaxis(read.images[index].numpy(), 0, -1) / 255.0))
        shown = read.masks[index, 0].numpy() / 255.0
        try:
            found = explain_by_light(image, model, placement, index, shown)
        except InputError as error:
            results.append((name, str(error)))
        else:
            seconds = shared + time.perf_counter() - begin
            grey = _is_grey(image, shown)
            error_px = found.landmark_error
            results.append(
                (name, PhotographFit(name, found.light.flat(), found.residual, error_px, grey, seconds))
            )
        on_photo()
    return results


def _is_grey(image: Array, shown: Array) -> bool:
    pixels = image[shown > 0.5]
    return bool(np.ptp(pixels, axis=-1).mean() < _GREY * pixels.mean()) if len(pixels) else True


class _Kept:
    """A file of fits: a header, then a line a photograph. A torn last line is done again."""

    def __init__(self, path: Path, header: dict[str, Any]) -> None:
        self.path, self.done, self.skipped = path, dict[str, PhotographFit | None](), dict[str, str]()
        if not path.is_file() or not path.read_bytes().strip():
            path.write_text(json.dumps(header) + "\n", encoding="utf-8")
            return
        whole, _, torn = path.read_text(encoding="utf-8").rpartition("\n")
        if torn:
            path.write_text(whole + "\n" if whole else json.dumps(header) + "\n", encoding="utf-8")
        try:
            found, *rows = [json.loads(line) for line in whole.splitlines()] or [header]
        except ValueError as error:
            raise InputError(f"{path}: a line is no JSON ({error}); remove the file to fit anew") from error
        if found != header:
            raise InputError(f"{path}: fits with {found} found, {header} asked for; choose another folder")
        for row in rows:
            self._take(row)

    def add(self, results: Sequence[tuple[str, PhotographFit | str]]) -> None:
        """Keep a batch."""
        rows = []
        for name, result in results:
            row = {"name": name, "skipped": result} if isinstance(result, str) else _row(result)
            rows.append(json.dumps(row))
            self._take(row)
        with self.path.open("a", encoding="utf-8") as file:
            file.write("".join(row + "\n" for row in rows))

    def _take(self, row: dict[str, Any]) -> None:
        if "skipped" in row:
            self.done[row["name"]] = None
            self.skipped[row["name"]] = row["skipped"]
        else:
            self.done[row["name"]] = PhotographFit(**(row | {"light": np.array(row["light"])}))


def _row(fit: PhotographFit) -> dict[str, Any]:
    plain: dict[str, Any] = dict(vars(fit))
    return plain | {"light": [float(f"{value:.7g}") for value in fit.light], "seconds": round(fit.seconds, 4)}
