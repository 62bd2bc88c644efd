"""Which of a rig's lights an image was taken under, by its estimated coefficients alone.

Protocol of LDAN (Zhou et al., CVPR 2017) as the paper uses it: coefficients are scaled to unit length; a
class is the mean of its images; an image belongs to the nearest mean. Each subject is left out of the means
that its own images are compared with.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError

Array = npt.NDArray[np.float64]


def class_ranks(lights: npt.ArrayLike, classes: Sequence[str], subjects: Sequence[str]) -> Array:
    """Place of the true class among all, 1 for the nearest, (N,).

    Args:
        lights: coefficients of N images, (N, K).
        classes: their true lights.
        subjects: whom they show; at least two.

    Raises:
        InputError: for other lengths, values that are not finite, one subject, or a light that only one
            subject was seen under.
    """
    values = np.asarray(lights, np.float64)
    if values.ndim != 2 or not len(values) == len(classes) == len(subjects):
        raise InputError(f"lights: shape {values.shape} found, ({len(classes)}, K) expected")
    if not np.isfinite(values).all():
        raise InputError("lights: NaN or inf found, finite coefficients expected")
    unit = values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)
    names, who = np.array(classes), np.array(subjects)
    kinds = sorted(set(classes))
    ranks = np.zeros(len(values))
    for subject in sorted(set(subjects)):
        others, own = who != subject, np.flatnonzero(who == subject)
        rows = [unit[others & (names == kind)] for kind in kinds]
        for kind, row in zip(kinds, rows, strict=True):
            if not len(row):
                raise InputError(f"lights: {kind} was seen with {subject} only, another subject is needed")
        means = np.array([row.mean(0) for row in rows])
        distance = np.linalg.norm(unit[own][:, None] - means[None], axis=2)
        true = distance[np.arange(len(own)), [kinds.index(name) for name in names[own]]]
        # Ties count against the method, so that equal answers for all images do not score.
        ranks[own] = (distance <= true[:, None]).sum(1)
    return ranks


def light_direction(shading: npt.ArrayLike) -> Array:
    """Where shading coefficients (N, 27) say that the light comes from: their linear part, unit (N, 3).

    Zero coefficients give the viewer's direction.
    """
    mean = np.asarray(shading, np.float64).reshape(-1, 3, 9).mean(1)
    vector = mean[:, [2, 3, 1]]
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    return np.asarray(np.where(length > 1e-12, vector / np.maximum(length, 1e-12), [0.0, 0.0, 1.0]))
