"""Fit a linear face model to landmarks, and a light to the photograph: the 3DMM baseline.

Regularised least squares by Gauss and Newton's steps, a whole batch of photographs at a time:

    sum_l (|p_l - q_l| / sigma_l)^2  +  |identity|^2  +  |expression / 0.3|^2  +  |turn / its spread|^2

with p_l the projected model points, q_l the landmarks, in Huber's form, because single landmarks are wrong.
Where a landmark of the jaw stands on a turned head follows in each step: on the outermost of the vertices
that it may stand on (``FaceModes.outline``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.conventions import EYE_DISTANCE, FACE_SIZE
from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.data.alignment import COUNT, JAW, skin_mask
from sfsnet_dr.estimation.sh_lighting import MEAN_SKIN, RIDGE, fit_light
from sfsnet_dr.render.rasterizer import rasterise
from sfsnet_dr.scene.faces.linear_model import FaceModes
from sfsnet_dr.scene.mesh import vertex_normals
from sfsnet_dr.sh.coefficients import Shading

Array = npt.NDArray[np.float64]

#: Where the camera stands, scene units: an 85 mm lens. Photographs do not tell.
DISTANCE: Final = 12.0
#: Decimetres between the eyes' centres of the models' common frame.
_EYES_APART: Final = 0.6155
_PIXELS_PER_UNIT: Final = FACE_SIZE / 2

#: Standard deviation of landmarks in canonical pixels, by part: jaw, brows, nose, eyes, mouth. That of the
#: marks themselves is about 1; the rest is what the modes should not bend a face for.
SIGMA: Final = np.repeat([4.0, 4.0, 2.0, 2.0, 3.0], [17, 10, 9, 12, 20])
#: By how much (canonical pixels) marks on photographs lie off the model's own landmarks in the brows (image
#: left, outside first; the other is its mirror image), down the nose, and along its base. Medians over 1,000
#: photographs that face the camera; without them heads come out bowed by 3 degrees.
_BROW_OFF: Final = ((-0.9, 1.0), (-0.7, 0.6), (0.1, 1.0), (-0.5, 1.7), (-0.5, 3.3))
_NOSE_OFF: Final = ((0.0, -0.5), (0.0, 0.8), (0.0, 2.1), (0.0, 2.2))
_BASE_OFF: Final = ((-0.15, -0.9), (-0.3, -0.3), (0.0, 0.5), (0.3, -0.3), (0.15, -0.9))

#: Standard deviations of the weights of face units, and of turns about x, y and z, degrees.
UNIT_SPREAD: Final = 0.3
TURN_SPREAD: Final = (12.0, 25.0, 12.0)
#: Standard deviations beyond which a landmark's pull no longer grows.
_HUBER: Final = 2.5
#: Gauss-Newton steps for the pose alone, then for all.
_POSE_STEPS, _STEPS = 6, 10
_FEWEST: Final = 8


@dataclass(frozen=True, eq=False)
class Placement:
    """Fitted parameters of B faces.

    Attributes:
        rotation: from the model to the camera frame, (B, 3, 3).
        shift: of the model's middle in scene units, x and y, (B, 2).
        scale: scene units a decimetre, (B,).
        weights: of the modes, (B, M).
        error: weighted mean distance of the landmarks that were given, canonical pixels, (B,).
    """

    rotation: Array
    shift: Array
    scale: Array
    weights: Array
    error: Array

    def __len__(self) -> int:
        return len(self.scale)


def fit_landmarks(model: FaceModes, landmarks: npt.ArrayLike) -> Placement:
    """Fit a batch of faces.

    Args:
        model: the face model.
        landmarks: (B, 68, 2) in the canonical frame, x right and y down; NaN where one was not seen.

    Raises:
        InputError: for another shape, or fewer than 8 landmarks of a face.
    """
    target = np.asarray(landmarks, np.float64)
    check_shape("landmarks", target, f"B {COUNT} 2")
    seen = np.asarray(np.isfinite(target).all(axis=-1))
    if (seen.sum(axis=-1) < _FEWEST).any():
        raise InputError(
            f"landmarks: {int(seen.sum(-1).min())} of a face found, {_FEWEST} at least are needed"
        )
    problem = _Problem(model, np.where(seen[..., None], target - marking_offsets(), 0.0), seen / SIGMA**2)
    for step in range(_POSE_STEPS + _STEPS):
        problem.step(weights_too=step >= _POSE_STEPS)
    return problem.placement()


def marking_offsets() -> Array:
    """(68, 2): where marks on photographs lie relative to the model's landmarks, canonical pixels."""
    offsets = np.zeros((COUNT, 2))
    offsets[17:22], offsets[22:27] = _BROW_OFF, np.array(_BROW_OFF)[::-1] * (-1.0, 1.0)
    offsets[27:31], offsets[31:36] = _NOSE_OFF, _BASE_OFF
    return offsets


def place_model(model: FaceModes, placement: Placement, index: int) -> Array:
    """Vertices (V, 3) of one fitted face in the camera frame, scene units."""
    centred = model.shape(placement.weights[index]) - _middle(model)
    turned = placement.scale[index] * centred @ placement.rotation[index].T
    return np.asarray(turned + np.append(placement.shift[index], 0.0))


def project_landmarks(points: Array) -> Array:
    """Canonical pixels (..., 2) of points (..., 3) in the camera frame, seen from ``DISTANCE``."""
    factor = _PIXELS_PER_UNIT * DISTANCE / (DISTANCE - points[..., 2:])
    return np.asarray(FACE_SIZE / 2 + factor * points[..., :2] * (1.0, -1.0))


class _Problem:
    """The state of a batch between steps."""

    def __init__(self, model: FaceModes, target: Array, precision: Array) -> None:
        count, modes = len(target), len(model.modes)
        self.model, self.target, self.precision = model, target, precision
        self.outline = model.mean[model.outline] - _middle(model)
        self.inner = model.mean[model.inner] - _middle(model)
        self.outline_modes = np.moveaxis(model.modes[:, model.outline], 0, 2).astype(np.float64)
        self.inner_modes = np.moveaxis(model.modes[:, model.inner], 0, 1).astype(np.float64)
        self.rotation = np.tile(np.eye(3), (count, 1, 1))
        self.scale = np.full(count, EYE_DISTANCE / _PIXELS_PER_UNIT / _EYES_APART)
        self.shift, self.weights = np.zeros((count, 2)), np.zeros((count, modes))
        spread = np.full(modes, UNIT_SPREAD)
        spread[: model.identities] = 1.0
        self.prior = 1 / spread**2
        self.turn_prior = 1 / np.radians(TURN_SPREAD) ** 2

    def step(self, weights_too: bool) -> None:
        """One step of Gauss and Newton."""
        from scipy.spatial.transform import Rotation

        points, modes = self._points()
        residual, jacobian = self._linearised(points, modes if weights_too else modes[:, :, :0])
        precision = self.precision * self._trust(residual)
        flat = jacobian.reshape(len(jacobian), 2 * COUNT, -1)
        weighted = flat.transpose(0, 2, 1) * np.repeat(precision, 2, axis=1)[:, None]
        normal = weighted @ flat
        right = (weighted @ residual.reshape(len(flat), -1, 1))[..., 0]
        turn = Rotation.from_matrix(self.rotation).as_rotvec()
        pull = [turn * self.turn_prior, np.zeros((len(turn), 3)), self.weights * self.prior]
        stiffness = np.concatenate([self.turn_prior, np.full(3, 1e-9), self.prior])
        size = normal.shape[-1]
        normal += np.diag(stiffness[:size])
        change = np.linalg.solve(normal, (right - np.concatenate(pull, axis=1)[:, :size])[..., None])[..., 0]
        self.rotation = Rotation.from_rotvec(change[:, :3]).as_matrix() @ self.rotation
        self.shift = self.shift + change[:, 3:5]
        self.scale = self.scale * np.exp(np.clip(change[:, 5], -0.5, 0.5))
        if weights_too:
            self.weights = self.weights + change[:, 6:]

    def placement(self) -> Placement:
        """The result."""
        residual = self._residual(self._points()[0])
        distance = np.linalg.norm(residual, axis=-1)
        error = (self.precision * distance).sum(-1) / self.precision.sum(-1)
        return Placement(self.rotation, self.shift, self.scale, self.weights, error)

    def _points(self) -> tuple[Array, Array]:
        """Landmarks (B, 68, 3) of the unturned models, and their modes (B, 68, M, 3)."""
        outline = self.outline + np.tensordot(self.weights, self.outline_modes, (1, 2))
        inner = self.inner + np.tensordot(self.weights, self.inner_modes, (1, 1))
        seen = self._seen(outline)
        outward = seen[:, :, 0] - self._seen(inner).mean(axis=1)[:, None]
        outermost = np.einsum("blcx,blx->blc", seen, outward).argmax(axis=-1)
        rows = np.arange(JAW.stop)
        jaw = np.take_along_axis(outline, outermost[..., None, None], axis=2)[:, :, 0]
        jaw_modes = self.outline_modes[rows, outermost]
        inner_modes = np.broadcast_to(self.inner_modes, (len(jaw), *self.inner_modes.shape))
        return np.concatenate([jaw, inner], axis=1), np.concatenate([jaw_modes, inner_modes], axis=1)

    def _seen(self, points: Array) -> Array:
        """Pixels (B, ..., 2) of points (B, ..., 3) of the unturned models."""
        return project_landmarks(self._in_camera(points))

    def _in_camera(self, points: Array) -> Array:
        turned = np.einsum("bxy,b...y->b...x", self.rotation * self.scale[:, None, None], points)
        extra = (1,) * (points.ndim - 2)
        shift = np.pad(self.shift, ((0, 0), (0, 1))).reshape(len(self.shift), *extra, 3)
        return np.asarray(turned + shift)

    def _residual(self, points: Array) -> Array:
        return (self.target - self._seen(points)) * (self.precision > 0)[..., None]

    def _trust(self, residual: Array) -> Array:
        """Huber's weights (B, 68)."""
        away = np.linalg.norm(residual, axis=-1) * np.sqrt(self.precision)
        return np.asarray(_HUBER / np.maximum(away, _HUBER))

    def _linearised(self, points: Array, modes: Array) -> tuple[Array, Array]:
        """Residuals (B, 68, 2) and derivatives (B, 68, 2, 6 + M): turn, shift, log scale, weights."""
        seen = self._in_camera(points)
        arm = seen - np.pad(self.shift, ((0, 0), (0, 1)))[:, None]
        x, y, z = np.moveaxis(arm, -1, 0)
        zero, one = np.zeros_like(x), np.ones_like(x)
        columns = [
            [zero, -z, y],  # a turn about x
            [z, zero, -x],
            [-y, x, zero],
            [one, zero, zero],
            [zero, one, zero],
            [x, y, z],
        ]
        rigid = np.moveaxis(np.array(columns), (0, 1), (-1, -2))
        turning = self.rotation * self.scale[:, None, None]
        soft = turning[:, None] @ modes.swapaxes(2, 3)
        depth = DISTANCE - seen[..., 2]
        factor = _PIXELS_PER_UNIT * DISTANCE / depth
        across = np.stack([factor, zero, factor * seen[..., 0] / depth], axis=-1)
        down = np.stack([zero, -factor, -factor * seen[..., 1] / depth], axis=-1)
        camera = np.stack([across, down], axis=-2)
        jacobian = camera @ np.concatenate([rigid, soft], axis=-1)
        return self._residual(points), jacobian


def _middle(model: FaceModes) -> Array:
    """The model's point that turns keep in place: the middle of its landmarks inside the face."""
    return np.asarray(model.mean[model.inner].mean(axis=0))


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
        InputError: for other shapes, too few landmarks, or a face of which too little is shown.
    """
    check_shape("photograph", photograph, f"{FACE_SIZE} {FACE_SIZE} 3")
    check_shape("landmarks", landmarks, "68 2")
    placement = fit_landmarks(model, landmarks[None])
    if shown is None:
        whole = bool(np.isfinite(landmarks).all())
        shown = skin_mask(landmarks).astype(np.float64) if whole else np.ones((FACE_SIZE, FACE_SIZE))
    return explain_by_light(photograph, model, placement, 0, shown, ridge, robust)


def explain_by_light(
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
        raise InputError("photograph: no skin of the fitted face is shown unclipped")
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
    vertices = place_model(model, placement, index)
    values = np.column_stack([vertex_normals(vertices, model.faces), model.skin, model.bare])
    points = project_landmarks(vertices) * (size / FACE_SIZE)
    picture, seen = rasterise(points, -vertices[:, 2], model.faces, values, size)
    length = np.linalg.norm(picture[..., :3], axis=-1, keepdims=True)
    normal = picture[..., :3] / np.where(length > 0, length, 1.0)
    # On an interpolated normal that points away the surface is seen edge on: no skin to count.
    facing = seen * (normal[..., 2] > 0)
    return FaceMaps(normal, facing * (picture[..., 3] > 0.5), facing * (picture[..., 4] > 0.5))
