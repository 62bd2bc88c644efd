"""Resolve the bas-relief ambiguity: by integrability, and by the mean slope of rendered heads.

Normals of a surface z(x, y) are its slopes p = dz/dx and q = dz/dy, and dp/dy = dq/dx. Lamps that were found
from pictures leave a linear map of the normals unknown, and most of such maps break this. One that matters is
a stretch of one image axis against the other: heads turn about the vertical far more than they nod, so that a
network knows the slopes across a face better than those down it.

A stretch of both axes alike and one along the line of sight keep the rule; pitch breaks it too little to be
measured (5 degrees change the sum below by 1 %).

Source: the rule, Frankot and Chellappa, PAMI 1988; for unknown lamps, Yuille and Snow, CVPR 1997.

Lamps that were found from pictures leave open how deep the faces are: slopes times s, and lamps moved toward
the viewer's axis, explain the same pictures (the generalised bas-relief ambiguity). What a network answered
stays in them, and networks answer too flat, because a mean over what a face may be is flatter than each.
Heads differ in depth, but the mean over many captures is that of many heads.

How steep a face is, is measured face by face: features that lie elsewhere in each would be lost in a mean
face, more so in that of heads that were shifted and turned.

Source: Belhumeur, Kriegman and Yuille, IJCV 1999.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_erosion, gaussian_filter
from scipy.optimize import minimize_scalar

from sfsnet_dr.core.errors import InputError

Array = npt.NDArray[np.float64]

#: Ratios that are tried; the search ends within ``_EXACT``.
_RANGE: Final = (0.7, 1.4)
_EXACT: Final = 0.002
#: Least n_z of pixels whose slopes mean something.
_STEEPEST: Final = 0.25
#: A difference of so many typical second derivatives is an outlier: an edge of hair, a wrong normal.
_SCALE: Final = 0.5
#: Pixels over which normals are averaged first: noise looks like slopes across and down alike, which draws
#: the ratio of flattened normals to 1.
_SMOOTH: Final = 1.0
#: Share of that average which must be known.
_WHOLE: Final = 0.95
#: Pixels of a face below which it says nothing.
_FEWEST: Final = 100


def vertical_scale_from_integrability(faces: Sequence[tuple[Array, npt.NDArray[np.bool_]]]) -> float:
    """The factor for n_y that makes normals those of surfaces, one for all faces; 1 if they cannot tell.

    Args:
        faces: normals of any length (H, W, 3), row 0 on top, x right, y up; and where they are known (H, W).
    """
    slopes = [_slopes(normal, mask) for normal, mask in faces]
    known = [face for face in slopes if len(face[0]) >= _FEWEST]
    if not known:
        return 1.0
    found = minimize_scalar(
        lambda ratio: float(np.mean([_misfit(*face, ratio) for face in known])),
        bounds=_RANGE, method="bounded", options={"xatol": _EXACT},
    )  # fmt: skip
    return float(found.x)


def _slopes(normal: Array, mask: npt.NDArray[np.bool_]) -> tuple[Array, Array]:
    """dp/dy and dq/dx at the pixels whose neighbours are known too, (P,) each."""
    normal, mask = _averaged(normal, mask)
    length = np.linalg.norm(normal, axis=-1)
    known = mask & (normal[..., 2] > _STEEPEST * length) & (length > 0)
    depth = np.where(known, normal[..., 2], 1.0)
    p, q = (np.where(known, -normal[..., axis] / depth, 0.0) for axis in (0, 1))
    down = (p[:-2, 1:-1] - p[2:, 1:-1]) / 2  # rows go down, y goes up
    across = (q[1:-1, 2:] - q[1:-1, :-2]) / 2
    inner = binary_erosion(known, iterations=2)[1:-1, 1:-1]
    return down[inner], across[inner]


def _averaged(normal: Array, mask: npt.NDArray[np.bool_]) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Averages over what is known around each pixel, and where that is nearly everything."""
    weight = gaussian_filter(mask.astype(np.float64), _SMOOTH)
    planes = [gaussian_filter(np.where(mask, plane, 0.0), _SMOOTH) for plane in np.moveaxis(normal, -1, 0)]
    total = np.stack(planes, -1)
    return total / np.maximum(weight, 1e-6)[..., None], mask & (weight > _WHOLE)


def _misfit(down: Array, across: Array, ratio: float) -> float:
    """Mean of Cauchy's loss of dp/dy - ratio dq/dx, in shares of their typical size."""
    stretched = ratio * across
    scale = _SCALE * np.median(np.abs(down) + np.abs(stretched)) + 1e-12
    return float(np.log1p(((down - stretched) / scale) ** 2).mean())


Known = npt.NDArray[np.bool_]

#: Least n_z at which slopes mean something.
_SLOPE_STEEPEST: Final = 0.35
#: A pixel counts that so many of the faces know.
_SHARED: Final = 0.9
#: A head counts that knows so many of those pixels, and whose mean normal there is within so many degrees of
#: the line of sight, sideways and up: a turned one has slopes on one side that no portrait shows.
_SEEN: Final = 0.5
_AHEAD: Final = 10.0
#: Pixels and heads below which nothing is told.
_FEWEST_PIXELS: Final = 100
FEWEST_HEADS: Final = 20
#: What is believed; beyond, something else is wrong.
_SLOPE_RANGE: Final = (0.7, 1.5)


def resolve_bas_relief_scale(
    faces: Sequence[tuple[Array, Known]], heads: Iterable[tuple[Array, Known]]
) -> float:
    """The factor for n_x and n_y for which the faces are as steep as heads are on average.

    Args:
        faces: normals of any length (H, W, 3), and where they are known (H, W); of people who look ahead.
        heads: the same of heads; those that are turned are left out.

    Returns:
        0.7 to 1.5; 1 if there are too few pixels that most faces know.

    Raises:
        InputError: if too few of the heads look ahead.
    """
    known_faces = [(normal, known) for normal, known in faces if known.any()]
    if not known_faces:
        return 1.0
    where = np.mean([known for _, known in known_faces], axis=0) >= _SHARED
    if where.sum() < _FEWEST_PIXELS:
        return 1.0
    usual = [_steepness(normal[known & where]) for normal, known in heads if _ahead(normal, known, where)]
    if len(usual) < FEWEST_HEADS:
        raise InputError(
            f"heads: {len(usual)} found that look ahead and show the skin that the captures show, "
            f"{FEWEST_HEADS} needed to tell how steep faces are; render more, as scenes/front_faces.toml does"
        )
    found = [_steepness(normal[known & where]) for normal, known in known_faces]
    return float(np.clip(float(np.mean(usual)) / max(float(np.mean(found)), 1e-9), *_SLOPE_RANGE))


def _steepness(normal: Array) -> float:
    """Mean absolute deviation of the slopes across and down from their medians, both added; (P, 3)."""
    length = np.linalg.norm(normal, axis=1)
    seen = normal[normal[:, 2] > _SLOPE_STEEPEST * length]
    slopes = seen[:, :2] / seen[:, 2:]
    return float(np.abs(slopes - np.median(slopes, axis=0)).mean(axis=0).sum())


def _ahead(normal: Array, known: Known, where: Known) -> bool:
    """Whether a head looks ahead and shows the pixels."""
    seen = known & where
    if seen.sum() < _SEEN * where.sum():
        return False
    mean = normal[seen].mean(axis=0)
    return bool(np.abs(mean[:2]).max() < np.tan(np.radians(_AHEAD)) * mean[2])
