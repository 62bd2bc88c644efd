"""Noise of a face's light transport, from captures of independent seeds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sfsnet_dr.render.capture import Capture


@dataclass(frozen=True)
class Noise:
    """Noise of one capture, relative to the image that a white sky gives.

    Attributes:
        transport, gloss, lamps: root mean square over responses, face pixels and colours; gloss is 0 for a
            surface without.
    """

    transport: float
    gloss: float
    lamps: float


@dataclass(frozen=True)
class Variances:
    """Mean variance of the responses of each kind."""

    transport: float
    gloss: float
    lamps: float


def noise_of(captures: list[Capture]) -> Noise:
    """Noise of one capture, estimated from several."""
    white = np.mean([maps.transport[0] for maps in captures], axis=0)[captures[0].mask > 0]
    scale = float(np.sqrt(np.mean(white**2)))
    spread = variances_of(captures)
    return Noise(*(float(np.sqrt(value)) / scale for value in (spread.transport, spread.gloss, spread.lamps)))


def variances_of(captures: list[Capture]) -> Variances:
    """Mean variance over face pixels, colours and the responses of a kind."""
    mask = captures[0].mask > 0

    def mean_variance(images: list[npt.NDArray[np.float32]]) -> float:
        if not len(images[0]):
            return 0.0
        return float(np.var(np.stack(images, dtype=np.float64), axis=0, ddof=1)[:, mask].mean())

    return Variances(
        mean_variance([maps.transport for maps in captures]),
        mean_variance([maps.gloss for maps in captures]),
        mean_variance([maps.lamps for maps in captures]),
    )
