"""Errors of images: relative in linear light, and in 8-bit sRGB units to stand beside published tables.

FLIP, a perceptual difference of images (Andersson et al. 2020), where ``flip-evaluator`` is installed.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError, check_shape

Array = npt.NDArray[np.float64]


def rel_rmse(image: npt.ArrayLike, reference: npt.ArrayLike, mask: npt.ArrayLike | None = None) -> float:
    """RMS of (image - reference) over the RMS of the reference, linear light.

    Args:
        image: (..., H, W, C).
        reference: the same shape, free of noise (else see ``render.compare``).
        mask: weights (..., H, W), all 1 if not given.

    Raises:
        InputError: for shapes that do not fit, NaN or inf, an empty mask or a black reference.
    """
    a, b, weight = _checked(image, reference, mask)
    power = _mean(b * b, weight)
    if power == 0:
        raise InputError("reference: black inside the mask, a relative error needs a lit one")
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
    from sfsnet_dr.core.color import linear_to_srgb  # colour-science is slow to import

    return 255 * np.asarray(linear_to_srgb(np.clip(linear, 0, 1)), dtype=np.float64)


def _mean(values: Array, weight: Array) -> float:
    return float(np.sum(values * weight[..., None]) / (values.shape[-1] * weight.sum()))


def _checked(
    image: npt.ArrayLike, reference: npt.ArrayLike, mask: npt.ArrayLike | None
) -> tuple[Array, Array, Array]:
    a, b = np.asarray(image, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if a.ndim < 3 or a.shape != b.shape:
        raise InputError(
            f"image: shape {a.shape} against reference {b.shape}, two equal (..., H, W, C) expected"
        )
    weight = np.ones(a.shape[:-1]) if mask is None else np.asarray(mask, dtype=np.float64)
    if weight.shape != a.shape[:-1]:
        raise InputError(f"mask: shape {weight.shape} found, {a.shape[:-1]} expected as of the image")
    for name, array in (("image", a), ("reference", b), ("mask", weight)):
        if not np.isfinite(array).all():
            raise InputError(f"{name}: NaN or inf found, finite values expected")
    if (weight < 0).any() or weight.sum() <= 0:
        raise InputError("mask: negative or no weight at all found, weights from 0 to 1 expected")
    return a, b, weight


#: How to get it: it is optional, because it only reports.
INSTALL: Final = "pip install flip-evaluator"


def has_flip() -> bool:
    """Whether the optional package is there."""
    return find_spec("flip_evaluator") is not None


def flip_metric(image: npt.ArrayLike, reference: npt.ArrayLike, mask: npt.ArrayLike) -> float:
    """Mean of the FLIP map over a mask, 0 (equal) to 1, for a viewer at 67 pixels a degree.

    What lies outside the mask is made equal in both images.

    Args:
        image: (H, W, 3) linear; clipped to [0, 1] and encoded as sRGB.
        reference: the same shape.
        mask: (H, W), weights from 0 to 1.

    Raises:
        InputError: for other shapes, an empty mask, or where the package is missing.
    """
    if not has_flip():
        raise InputError(f"FLIP: not installed; {INSTALL}")
    import flip_evaluator

    from sfsnet_dr.core.color import linear_to_srgb

    pair = [np.asarray(values, dtype=np.float64) for values in (reference, image)]
    weight = np.asarray(mask, dtype=np.float64)
    sizes = check_shape("image", pair[1], "H W 3")
    check_shape("reference", pair[0], "H W 3", **sizes)
    check_shape("mask", weight, "H W", **sizes)
    if weight.sum() <= 0:
        raise InputError("mask: empty, at least one pixel expected")
    shown = [
        np.asarray(linear_to_srgb(np.clip(values, 0, 1)) * (weight[..., None] > 0), dtype=np.float32)
        for values in pair
    ]
    map_, _, _ = flip_evaluator.evaluate(*shown, "LDR", applyMagma=False, computeMeanError=False)
    return float((np.asarray(map_)[..., 0] * weight).sum() / weight.sum())
