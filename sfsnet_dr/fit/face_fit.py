"""The classical answer to one photograph: a face model fitted to landmarks, and the light on it.

No learning, and no detail beyond the model's modes: what the paper's Table 1 calls 3DMM.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.base.checks import BadInput, check_shape
from sfsnet_dr.base.conventions import FACE_SIZE
from sfsnet_dr.data.landmarks import skin_mask
from sfsnet_dr.fit.landmark_fit import Placement, fit_landmarks, placed, projected
from sfsnet_dr.fit.light_fit import MEAN_SKIN, RIDGE, fit_light
from sfsnet_dr.render.raster import rasterise
from sfsnet_dr.scene.face_modes import FaceModes
from sfsnet_dr.scene.mesh import vertex_normals
from sfsnet_dr.sh.coefficients import Shading

Array = npt.NDArray[np.float64]

#: Linear value from which a pixel counts as clipped: 250 of 255.
CLIPPED: Final = 0.956


@dataclass(frozen=True, eq=False)
class FaceMaps:
    """What a fitted model shows in the canonical frame.

    Attributes:
        normal: unit normals in the camera frame, (128, 128, 3); 0 where the model is not seen.
        mask: 1 on skin of the face, lips and brows included, (128, 128).
        bare: 1 on skin of the face without lips, brows and lids, (128, 128).
    """

    normal: Array
    mask: Array
    bare: Array


@dataclass(frozen=True, eq=False)
class FaceFit:
    """A photograph explained by the model.

    Attributes:
        normal: unit normals in the camera frame, (128, 128, 3); 0 where the model is not seen.
        mask: 1 on the model's skin where the photograph shows it, (128, 128) in [0, 1].
        light: order-2 shading coefficients under a mean skin's albedo.
        weights: how far the light's fit trusts each pixel, (128, 128) in [0, 1].
        residual: of the light, relative; see ``fit.light_fit``.
        landmark_error: mean distance of the landmarks, canonical pixels.
    """

    normal: Array
    mask: Array
    light: Shading
    weights: Array
    residual: float
    landmark_error: float


def fit_face(
    photograph: Array,
    landmarks: Array,
    model: FaceModes,
    shown: Array | None = None,
    ridge: float = RIDGE,
    robust: bool = True,
) -> FaceFit:
    """Fit one photograph.

    Args:
        photograph: linear (128, 128, 3) in the canonical frame; grey ones have three equal colours.
        landmarks: (68, 2) in the same frame; NaN where one was not seen.
        model: of ``scene.face_modes.load_face_modes``.
        shown: share of each pixel that counts, (128, 128): the photograph's own mask, say. Left out, the skin
            that whole landmarks outline, else all that the model covers.
        ridge, robust: of the light; see ``fit.light_fit``.

    Raises:
        BadInput: for other shapes, too few landmarks, or a face of which too little is shown.
    """
    check_shape("photograph", photograph, f"{FACE_SIZE} {FACE_SIZE} 3")
    check_shape("landmarks", landmarks, "68 2")
    placement = fit_landmarks(model, landmarks[None])
    if shown is None:
        whole = bool(np.isfinite(landmarks).all())
        shown = skin_mask(landmarks).astype(np.float64) if whole else np.ones((FACE_SIZE, FACE_SIZE))
    return explain(photograph, model, placement, 0, shown, ridge, robust)


def explain(
    photograph: Array,
    model: FaceModes,
    placement: Placement,
    index: int,
    shown: Array,
    ridge: float = RIDGE,
    robust: bool = True,
) -> FaceFit:
    """The maps and the light of one fitted face of a batch; arguments as of ``fit_face``."""
    maps = face_maps(model, placement, index)
    clear = (np.asarray(photograph).max(axis=-1) < CLIPPED) & (maps.bare > 0.5)
    if not clear.any():
        raise BadInput("photograph: no skin of the fitted face is shown unclipped")
    found = fit_light(maps.normal, photograph, shown * clear, MEAN_SKIN, ridge, robust)
    return FaceFit(
        maps.normal,
        maps.mask * shown,
        found.light,
        found.weights,
        found.residual,
        float(placement.error[index]),
    )


def face_maps(model: FaceModes, placement: Placement, index: int, size: int = FACE_SIZE) -> FaceMaps:
    """Normals and skin of a fitted face, at the centres of ``size`` pixels."""
    vertices = placed(model, placement, index)
    values = np.column_stack([vertex_normals(vertices, model.faces), model.skin, model.bare])
    points = projected(vertices) * (size / FACE_SIZE)
    picture, seen = rasterise(points, -vertices[:, 2], model.faces, values, size)
    length = np.linalg.norm(picture[..., :3], axis=-1, keepdims=True)
    normal = picture[..., :3] / np.where(length > 0, length, 1.0)
    # On an interpolated normal that points away the surface is seen edge on: no skin to count.
    facing = seen * (normal[..., 2] > 0)
    return FaceMaps(normal, facing * (picture[..., 3] > 0.5), facing * (picture[..., 4] > 0.5))
