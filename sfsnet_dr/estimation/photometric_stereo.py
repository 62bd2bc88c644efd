"""Calibrated photometric stereo: normals and albedo of a face from pictures under known single lights.

Model, for each pixel alone: I_j = g_j max(b . l_j, 0), with b = albedo times normal, l_j the direction toward
light j and g_j its strength. Values that break the model lose their say: saturated and black ones have none;
attached shadows (b . l_j <= 0) leave the sum; gloss and cast shadows are outliers whose weight falls with the
residual r = (I_j / g_j - b . l_j) / (0.1 |b|) as 1 / (1 + r^2), Cauchy's, by iteratively reweighted least
squares. The iteration starts from each pixel's brighter lights without the very brightest, where neither
shadow nor gloss is likely. No library that is kept up does this; the sums are NumPy's.

Source: Woodham 1980; robust fits as in Wu et al., ACCV 2010, compared there with others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError, check_shape

Array = npt.NDArray[np.float64]

#: Fewest lights: three unknowns a pixel, and one more to notice an outlier.
FEWEST: Final = 4
#: Values outside of this range say only that a pixel is black or saturated; in shares of the largest value.
BLACK: Final = 0.008
SATURATED: Final = 0.98

#: Residual, in shares of the albedo, at which a light's weight has fallen to a half.
SCALE: Final = 0.1
#: Least cosine between normal and light that takes part; nearer to the terminator lights are uncertain.
GRAZING: Final = 0.1
_ROUNDS: Final = 15
#: Angle (degrees) of standard error at which confidence has fallen to a half.
HALF_CONFIDENCE: Final = 5.0
#: Pixels solved at once; bounds memory.
_CHUNK: Final = 8192


@dataclass(frozen=True, eq=False)
class Surface:
    """What the lights tell about a face; maps of (H, W).

    Attributes:
        normal: unit vectors in the camera frame, (H, W, 3); toward the viewer where nothing is known.
        albedo: of each colour, (H, W, C): the value of the pixel facing a light of strength 1.
        residual: RMS difference between picture and model over the lights that count, in shares of the
            albedo.
        error_deg: standard error of the normal by the spread of its lights and the residual, degrees.
        confidence: 1 / (1 + (error_deg / 5)^2) in [0, 1]; 0 with fewer than three lights that count.
    """

    normal: Array
    albedo: Array
    residual: Array
    error_deg: Array
    confidence: Array


def photometric_stereo(
    images: npt.ArrayLike,
    directions: npt.ArrayLike,
    gains: npt.ArrayLike,
    mask: npt.ArrayLike | None = None,
) -> Surface:
    """Normals, albedo, and how sure they are.

    Args:
        images: linear, one a light, (N, H, W, C), 0 to 1, N >= 4.
        directions: toward the lights, (N, 3), any length above 0.
        gains: strengths of the lights, (N,), above 0.
        mask: (H, W), pixels above 0 are solved; all if not given. Others know nothing.

    Raises:
        InputError: for other shapes, fewer lights, lights in one plane, or values that are not finite.
    """
    pictures, gain = np.asarray(images, np.float64), np.asarray(gains, np.float64)
    sizes = check_shape("images", pictures, "N H W C")
    lights = unit_directions(directions, sizes["N"])
    check_shape("gains", gain, "N", N=sizes["N"])
    if not np.isfinite(pictures).all() or not (np.isfinite(gain) & (gain > 0)).all():
        raise InputError("images, gains: NaN, inf or a strength of 0 found, finite values are needed")
    flat = np.moveaxis(pictures, 0, -2).reshape(-1, sizes["N"], sizes["C"])
    size = (sizes["H"], sizes["W"])
    chosen = np.arange(len(flat)) if mask is None else np.flatnonzero(np.asarray(mask) > 0)
    normal = np.tile([0.0, 0.0, 1.0], (len(flat), 1))
    albedo, others = np.zeros((len(flat), sizes["C"])), np.zeros((3, len(flat)))
    others[1] = 90.0
    for begin in range(0, len(chosen), _CHUNK):
        part = chosen[begin : begin + _CHUNK]
        normal[part], albedo[part], *rest = _solve(flat[part], lights, gain)
        others[:, part] = rest
    residual, error, confidence = others.reshape(3, *size)
    return Surface(normal.reshape(*size, 3), albedo.reshape(*size, -1), residual, error, confidence)


def unit_directions(directions: npt.ArrayLike, count: int) -> Array:
    """Unit vectors toward at least four lights.

    Raises:
        InputError: for fewer, another shape, a zero vector, or lights that all lie near one plane through the
            face, which leaves one component of every normal unknown.
    """
    vectors = np.asarray(directions, np.float64)
    check_shape("directions", vectors, "N 3", N=count)
    if count < FEWEST:
        raise InputError(f"lights: {count} found, at least {FEWEST} are needed")
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    if not (np.isfinite(length) & (length > 0)).all():
        raise InputError("directions: a zero, NaN or infinite vector found")
    vectors = vectors / length
    thinnest = float(np.linalg.svd(vectors, compute_uv=False)[-1])
    if thinnest < 0.05:
        raise InputError("directions: all lights lie in one plane, so that normals cannot be told apart")
    return np.asarray(vectors)


def fit_pixels(values: Array, valid: Array, lights: Array, rounds: int = _ROUNDS) -> tuple[Array, Array]:
    """Scaled normals (P, 3) and the lights' last weights (P, N).

    Args:
        values: pictures divided by the strengths, (P, N).
        valid: 1 where a value means something, else 0, (P, N).
        lights: unit vectors, (N, 3).
        rounds: of reweighting.
    """
    scaled = _least_squares(_first_weights(values, valid), values, lights)
    weights = valid
    for _ in range(rounds):
        model = scaled @ lights.T
        size = np.linalg.norm(scaled, axis=1, keepdims=True) + 1e-9
        ratio = (values - model) / (SCALE * size)
        weights = valid * (model > GRAZING * size) / (1 + ratio * ratio)
        scaled = _least_squares(weights, values, lights)
    return scaled, weights


def is_valid(images: Array) -> Array:
    """1 where a value is neither black nor saturated, else 0; the same shape."""
    return ((images > BLACK) & (images < SATURATED)).astype(np.float64)


def _first_weights(values: Array, valid: Array) -> Array:
    """The brighter 60 % of a pixel's lights, but for the brightest 8 % of many."""
    count = values.shape[1]
    rank = np.argsort(np.argsort(-np.where(valid > 0, values, -1.0), axis=1), axis=1)
    first = int(0.08 * count)
    last = first + max(FEWEST - 1, round(0.52 * count))
    return np.asarray(valid * ((rank >= first) & (rank < last)) + 1e-3 * valid)


def _least_squares(weights: Array, values: Array, lights: Array) -> Array:
    # The ridge keeps pixels without lights solvable; it is far below one light's weight.
    matrix = normal_matrix(weights, lights, 1e-6)
    return np.asarray(np.linalg.solve(matrix, ((weights * values) @ lights)[..., None])[..., 0])


def normal_matrix(weights: Array, lights: Array, ridge: float) -> Array:
    """Sum of w l l^T over the lights (N, 3), plus a ridge, for each row of weights (P, N): (P, 3, 3)."""
    products = (lights[:, :, None] * lights[:, None, :]).reshape(len(lights), 9)
    return np.asarray((weights @ products).reshape(-1, 3, 3) + ridge * np.eye(3))


def _solve(colours: Array, lights: Array, gains: Array) -> tuple[Array, ...]:
    """Maps of the pixels (P, N, C), each (P, ...)."""
    valid = is_valid(colours).min(axis=2)
    values = colours.mean(axis=2) / gains
    scaled, weights = fit_pixels(values, valid, lights)
    size = np.linalg.norm(scaled, axis=1, keepdims=True)
    known = size[:, 0] > 1e-6
    normal = np.where(known[:, None], scaled / np.maximum(size, 1e-6), [0.0, 0.0, 1.0])
    shade = np.maximum(normal @ lights.T, 0)
    total = np.maximum((weights * shade * shade).sum(1), 1e-9)
    per_light = colours / gains[:, None]
    albedo = np.einsum("pn,pnc->pc", weights * shade, per_light) / total[:, None]
    count = weights.sum(1)
    relative = (values - scaled @ lights.T) / np.maximum(size, 1e-6)
    # Three of the lights' say went into the normal and are not free to differ from it.
    free = np.maximum(count - 3, 0.5)
    residual = np.sqrt((weights * relative**2).sum(1) / free)
    error = _standard_error(weights, lights, normal, np.maximum(residual, 0.01))
    confidence = np.where(
        known & ((weights > 0.1).sum(1) >= 3), 1 / (1 + (error / HALF_CONFIDENCE) ** 2), 0.0
    )
    return normal, albedo, residual, error, confidence


def _standard_error(weights: Array, lights: Array, normal: Array, residual: Array) -> Array:
    """Root of the variance across the normal, degrees, at most 90."""
    covariance = np.linalg.inv(normal_matrix(weights, lights, 1e-4))
    along = np.einsum("pi,pij,pj->p", normal, covariance, normal)
    across = np.maximum(np.trace(covariance, axis1=1, axis2=2) - along, 0)
    return np.asarray(np.degrees(np.minimum(residual * np.sqrt(across), np.pi / 2)))
