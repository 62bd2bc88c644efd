"""Errors of images: relative in linear light, and in 8-bit sRGB units to stand beside published tables."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.checks import BadInput

Array = npt.NDArray[np.float64]


def rel_rmse(image: npt.ArrayLike, reference: npt.ArrayLike, mask: npt.ArrayLike | None = None) -> float:
    """RMS of (image - reference) over the RMS of the reference, linear light.

    Args:
        image: (..., H, W, C).
        reference: the same shape, free of noise (else see ``render.compare``).
        mask: weights (..., H, W), all 1 if not given.

    Raises:
        BadInput: for shapes that do not fit, NaN or inf, an empty mask or a black reference.
    """
    a, b, weight = _checked(image, reference, mask)
    power = _mean(b * b, weight)
    if power == 0:
        raise BadInput("reference: black inside the mask, a relative error needs a lit one")
    return float(np.sqrt(_mean((a - b) ** 2, weight) / power))


def mae_8bit(image: npt.ArrayLike, reference: npt.ArrayLike, mask: npt.ArrayLike | None = None) -> float:
    """Mean absolute difference in 8-bit sRGB units, 0 to 255; linear arguments as ``rel_rmse``.

    Both images are clipped to [0, 1] and encoded; they are not rounded to whole units.
    """
    a, b, weight = _checked(image, reference, mask)
    return _mean(np.abs(_encode(a) - _encode(b)), weight)


def rmse_8bit(image: npt.ArrayLike, reference: npt.ArrayLike, mask: npt.ArrayLike | None = None) -> float:
    """Root-mean-square difference in 8-bit sRGB units, 0 to 255; otherwise as ``mae_8bit``."""
    a, b, weight = _checked(image, reference, mask)
    return float(np.sqrt(_mean((_encode(a) - _encode(b)) ** 2, weight)))


def psnr(image: npt.ArrayLike, reference: npt.ArrayLike, mask: npt.ArrayLike | None = None) -> float:
    """Peak signal-to-noise ratio in dB of the encoded images, 20 log10(255 / rmse_8bit); inf if equal."""
    error = rmse_8bit(image, reference, mask)
    return float(20 * np.log10(255 / error)) if error > 0 else float("inf")


def _encode(linear: Array) -> Array:
    from sfsnet_dr.base.color import linear_to_srgb  # colour-science is slow to import

    return 255 * np.asarray(linear_to_srgb(np.clip(linear, 0, 1)), dtype=np.float64)


def _mean(values: Array, weight: Array) -> float:
    return float(np.sum(values * weight[..., None]) / (values.shape[-1] * weight.sum()))


def _checked(
    image: npt.ArrayLike, reference: npt.ArrayLike, mask: npt.ArrayLike | None
) -> tuple[Array, Array, Array]:
    a, b = np.asarray(image, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if a.ndim < 3 or a.shape != b.shape:
        raise BadInput(
            f"image: shape {a.shape} against reference {b.shape}, two equal (..., H, W, C) expected"
        )
    weight = np.ones(a.shape[:-1]) if mask is None else np.asarray(mask, dtype=np.float64)
    if weight.shape != a.shape[:-1]:
        raise BadInput(f"mask: shape {weight.shape} found, {a.shape[:-1]} expected as of the image")
    for name, array in (("image", a), ("reference", b), ("mask", weight)):
        if not np.isfinite(array).all():
            raise BadInput(f"{name}: NaN or inf found, finite values expected")
    if (weight < 0).any() or weight.sum() <= 0:
        raise BadInput("mask: negative or no weight at all found, weights from 0 to 1 expected")
    return a, b, weight
