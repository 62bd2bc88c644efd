"""How much flatter faces were found than heads are, where pictures alone cannot tell.

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

from sfsnet_dr.base.checks import BadInput

Array = npt.NDArray[np.float64]
Known = npt.NDArray[np.bool_]

#: Least n_z at which slopes mean something.
_STEEPEST: Final = 0.35
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
_RANGE: Final = (0.7, 1.5)


def usual_slopes(faces: Sequence[tuple[Array, Known]], heads: Iterable[tuple[Array, Known]]) -> float:
    """The factor for n_x and n_y for which the faces are as steep as heads are on average.

    Args:
        faces: normals of any length (H, W, 3), and where they are known (H, W); of people who look ahead.
        heads: the same of heads; those that are turned are left out.

    Returns:
        .7 to 1.5; 1 if there are too few pixels that most faces know.

    Raises:
        BadInput: if too few of the heads look ahead.
    """
    known_faces = [(normal, known) for normal, known in faces if known.any()]
    if not known_faces:
        return 1.0
    where = np.mean([known for _, known in known_faces], axis=0) >= _SHARED
    if where.sum() < _FEWEST_PIXELS:
        return 1.0
    usual = [_steepness(normal[known & where]) for normal, known in heads if _ahead(normal, known, where)]
    if len(usual) < FEWEST_HEADS:
        raise BadInput(
            f"heads: {len(usual)} found that look ahead and show the skin that the captures show, "
            f"{FEWEST_HEADS} needed to tell how steep faces are; render more, as scenes/front_faces.toml does"
        )
    found = [_steepness(normal[known & where]) for normal, known in known_faces]
    return float(np.clip(float(np.mean(usual)) / max(float(np.mean(found)), 1e-9), *_RANGE))


def _steepness(normal: Array) -> float:
    """Mean absolute deviation of the slopes across and down from their medians, both added; (P, 3)."""
    length = np.linalg.norm(normal, axis=1)
    seen = normal[normal[:, 2] > _STEEPEST * length]
    slopes = seen[:, :2] / seen[:, 2:]
    return float(np.abs(slopes - np.median(slopes, axis=0)).mean(axis=0).sum())


def _ahead(normal: Array, known: Known, where: Known) -> bool:
    """Whether a head looks ahead and shows the pixels."""
    seen = known & where
    if seen.sum() < _SEEN * where.sum():
        return False
    mean = normal[seen].mean(axis=0)
    return bool(np.abs(mean[:2]).max() < np.tan(np.radians(_AHEAD)) * mean[2])
