"""How much flatter faces were found than heads usually are, where pictures alone cannot tell.

Lamps that were found from pictures leave open how deep the faces are: slopes times s, and lamps moved toward
the viewer's axis, explain the same pictures (the generalised bas-relief ambiguity). What a network answered
stays in them, and networks answer too flat, because a mean over what a face may be is flatter than each.
Heads differ in depth, but the mean over many captures is that of many heads.

Source: Belhumeur, Kriegman and Yuille, IJCV 1999.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Least n_z, of a mean of unit normals, at which its slopes mean something.
_STEEPEST: Final = 0.4
#: Pixels below which nothing is told.
_FEWEST: Final = 100
#: What is believed; beyond, something else is wrong.
_RANGE: Final = (0.7, 1.5)


def usual_slopes(faces: Sequence[tuple[Array, npt.NDArray[np.bool_]]], usual: Array) -> float:
    """The factor for n_x and n_y for which faces are as steep as usual heads; 1 if they cannot tell.

    It is the least-squares fit of the slopes n_x / n_z and n_y / n_z of the mean face as a multiple of those
    of the mean head, over the pixels that both have.

    Args:
        faces: normals of any length (H, W, 3), and where they are known (H, W).
        usual: mean of the unit normals of heads (H, W, 3), 0 where it is not known.

    Returns:
        .7 to 1.5.
    """
    total, count = np.zeros_like(usual), np.zeros(usual.shape[:2])
    for normal, known in faces:
        length = np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        total += normal / length * known[..., None]
        count += known
    mean = total / np.maximum(count, 1)[..., None]
    both = (mean[..., 2] > _STEEPEST) & (usual[..., 2] > _STEEPEST)
    if both.sum() < _FEWEST:
        return 1.0
    found, wanted = (part[both][:, :2] / part[both][:, 2:] for part in (mean, usual))
    return float(np.clip((wanted * wanted).sum() / max((found * wanted).sum(), 1e-9), *_RANGE))
