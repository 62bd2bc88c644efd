"""The light on a face whose normals are known: 27 shading coefficients by robust ridge regression.

    sum_p v_p |I_p / a_p - Y(n_p)^T L|^2  +  ridge * (sum_p v_p) * sum_c L_c^T M^-1 L_c,    v_p = w_p |a_p|^2

over face pixels p and colours c. The albedo a is assumed, not estimated: one colour of skin for all pixels
and people. So the colour and the level of somebody's skin become the light's. The weights w_p are those of
Tukey's biweight after a start by Huber's: gloss, hair and glasses lose their say, cast shadows most of it.

The ridge is there because a face shows half of all normals, on which the nine functions are nearly dependent.
M is the second moment of plain lights (one from anywhere before or beside the face, and ambient), so that
what the face does not show is filled in as such lights have it. A ridge with one number a band is worse: on
the development subjects of Extended Yale B, by least squares and on fitted normals, the linear part pointed
23 degrees away from the true light with (0, 1, 4) a band, and 13 with this one.

Source of the model: Sengupta et al., CVPR 2018, eq. 1; of the weights: Holland and Welsch (1977).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.conventions import LIGHT_ORDER
from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.coefficients import Shading
from sfsnet_dr.sh.icosphere import icosphere
from sfsnet_dr.sh.kernel import band_of, clamped_cosine

Array = npt.NDArray[np.float64]

#: Linear skin colour that is assumed: the mean of the project's rendered faces, dark to light.
MEAN_SKIN: Final = (0.285, 0.158, 0.102)
#: Weight of the ridge.
RIDGE: Final = 1e-4
#: Lights behind M: greatest angle from the viewer in degrees, and shares of ambient light.
_LARGEST_ANGLE: Final = 110.0
_AMBIENT: Final = (0.0, 0.2, 0.4, 0.6, 0.8)

#: Tuning constants of both weights, in standard deviations: 95 % efficient on normal errors.
_HUBER, _TUKEY = 1.345, 4.685
_HUBER_STEPS, _TUKEY_STEPS = 6, 10
#: Least standard deviation, as a share of the upper quartile of the face's brightness. Under hard light most
#: of a face can be dark and fitted well: by the median alone its lit part would be the outlier.
_LEAST_SPREAD: Final = 0.15
#: Least pixels for nine numbers a colour.
_FEWEST: Final = 50


@dataclass(frozen=True, eq=False)
class LightFit:
    """A fitted light.

    Attributes:
        light: order-2 shading coefficients under the assumed albedo.
        weights: final weight of each pixel in [0, 1], (H, W); 0 off the mask.
        residual: robust relative residual: 1.4826 times the median distance of image and fit (over colours),
            divided by the median brightness of the image.
    """

    light: Shading
    weights: Array
    residual: float


def fit_light(
    normal: Array,
    image: Array,
    mask: Array,
    albedo: npt.ArrayLike = MEAN_SKIN,
    ridge: float = RIDGE,
    robust: bool = True,
) -> LightFit:
    """Fit the light of one face.

    Under one lamp from beside or behind most of a face is dark, and robust weights give up what is lit. On
    the development subjects of Extended Yale B the linear part then points 54 degrees away from lamps beyond
    77 degrees, by least squares 17; up to 77 degrees 12 to 15, against 11 to 12. Usual photographs have no
    such light, but gloss, hair and glasses.

    Args:
        normal: unit normals (H, W, 3); read where the mask is above 0.
        image: linear (H, W, 3).
        mask: share of each pixel that counts, (H, W) in [0, 1]; leave clipped pixels out.
        albedo: linear, (3,) or (H, W, 3), above 0.
        ridge: see above; relative to the data's own weight.
        robust: whether pixels lose weight that do not fit; least squares otherwise.

    Raises:
        InputError: for other shapes, values that are not finite, or a mask of fewer than 50 pixels.
    """
    sizes = check_shape("normal", normal, "H W 3")
    check_shape("image", image, "H W 3", **sizes)
    check_shape("mask", mask, "H W", **sizes)
    rows = mask > 0
    if int(rows.sum()) < _FEWEST:
        raise InputError(
            f"mask: {int(rows.sum())} pixels found, {_FEWEST} at least are needed to fit a light"
        )
    tone = np.broadcast_to(np.asarray(albedo, np.float64), image.shape)[rows]
    seen, share = np.asarray(image, np.float64)[rows], np.asarray(mask, np.float64)[rows]
    if not (np.isfinite(seen).all() and np.isfinite(normal[rows]).all() and (tone > 0).all()):
        raise InputError(
            "fit_light: NaN, inf or an albedo of 0 found, finite pixels and albedos above 0 needed"
        )
    basis = sh_basis(normal[rows], LIGHT_ORDER)
    light, weights = _weighted_fit(basis, seen, tone, share, ridge, robust)
    distance = _distance(basis, seen, tone, light)
    level = max(float(np.median(np.linalg.norm(seen, axis=1))), 1e-12)
    picture = np.zeros(mask.shape)
    picture[rows] = weights
    return LightFit(Shading(light), picture, 1.4826 * float(np.median(distance)) / level)


@cache
def _stiffness() -> Array:
    """M^-1 (9, 9) for coefficients of mean shading 1."""
    directions = icosphere(3)
    near = directions[directions[:, 2] >= np.cos(np.radians(_LARGEST_ANGLE))]
    factors = (clamped_cosine(LIGHT_ORDER) / np.pi)[band_of(LIGHT_ORDER)]
    plain = sh_basis(near, LIGHT_ORDER) * factors
    plain = plain / plain[:, :1]
    ambient = np.eye(1, plain.shape[1])
    lights = np.concatenate([share * ambient + (1 - share) * plain for share in _AMBIENT])
    return np.asarray(np.linalg.inv(lights.T @ lights / len(lights)))


def _weighted_fit(
    basis: Array, image: Array, tone: Array, share: Array, ridge: float, robust: bool
) -> tuple[Array, Array]:
    """Coefficients (9, 3) and the weights (N,) that they were found with."""
    shading, share = image / tone, share * (tone**2).sum(axis=1)
    least = _LEAST_SPREAD * float(np.quantile(np.linalg.norm(image, axis=1), 0.75))
    weights = np.ones(len(basis))
    light = _ridge_fit(basis, shading, share, ridge)
    for step in range(_HUBER_STEPS + _TUKEY_STEPS if robust else 0):
        distance = _distance(basis, image, tone, light)
        spread = max(1.4826 * float(np.median(distance)), least, 1e-9)
        if step < _HUBER_STEPS:
            weights = _HUBER * spread / np.maximum(distance, _HUBER * spread)
        else:
            weights = np.maximum(1 - (distance / (_TUKEY * spread)) ** 2, 0.0) ** 2
        light = _ridge_fit(basis, shading, share * weights, ridge)
    return light, weights


def _ridge_fit(basis: Array, shading: Array, weights: Array, ridge: float) -> Array:
    """Coefficients (9, 3)."""
    weighted = weights[:, None] * basis
    matrix = weighted.T @ basis + ridge * weights.sum() * _stiffness()
    return np.asarray(np.linalg.solve(matrix, weighted.T @ shading))


def _distance(basis: Array, image: Array, tone: Array, light: Array) -> Array:
    """Distance (N,) of image and fit over the colours."""
    off = image - tone * (basis @ light)
    return np.asarray(np.sqrt(np.einsum("nc,nc->n", off, off)))
