"""A decomposed face under other lights."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.core.conventions import LIGHT_ORDER
from sfsnet_dr.render.shading_numpy import f_render
from sfsnet_dr.sh.coefficients import Shading
from sfsnet_dr.sh.projection import project_directional

Array = NDArray[np.floating]

#: Directions to the three lights of the relit views (camera frame), by the side of the image they come from.
VIEW_LIGHTS: Final[dict[str, tuple[float, float, float]]] = {
    "left": (-1.0, 0.2, 0.7),
    "right": (1.0, 0.2, 0.7),
    "top": (0.0, 1.0, 0.7),
}


def directional_shading(direction: tuple[float, float, float]) -> Shading:
    """Order-2 shading of one white, infinitely distant light of irradiance pi.

    A surface that faces it has shading 17/16: order 2 overshoots the clamped cosine's 1 by a sixteenth.
    """
    return project_directional(np.array(direction), np.full(3, np.pi), LIGHT_ORDER).to_shading()


def relight(normal: Array, albedo: Array, light: Shading) -> NDArray[np.float64]:
    """Image of normals and albedo under a light, without shadows or interreflection.

    Order 2 rings below zero away from the light; such values are set to 0 because the result is looked at.

    Args:
        normal: (H, W, 3), camera frame.
        albedo: (H, W, 3), linear.
        light: shading coefficients.

    Returns:
        (H, W, 3) linear, not negative where the albedo is not.
    """
    planes = [np.moveaxis(part, -1, 0)[None] for part in (normal, albedo)]
    image = f_render(planes[0], planes[1], light.flat()[None])
    return np.asarray(np.maximum(np.moveaxis(image[0], 0, -1), 0.0), dtype=np.float64)


def relit_views(normal: Array, albedo: Array) -> dict[str, NDArray[np.float64]]:
    """The face lit from the image's left, its right and the top, one directional light each."""
    return {name: relight(normal, albedo, directional_shading(way)) for name, way in VIEW_LIGHTS.items()}
