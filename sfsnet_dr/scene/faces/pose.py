"""Brings a head into the canonical face frame: turned, then moved until its eyes are in place."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.conventions import EYE_IMAGE_LEFT, EYE_IMAGE_RIGHT, FACE_SIZE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.spec import CameraSpec, HeadSpec

Array = npt.NDArray[np.float64]

_PIXELS_PER_UNIT = FACE_SIZE / 2  # at z = 0: the view is 2 units wide whatever the focal length

#: Width of film, mm, and the share of it that the canonical frame fills.
_FILM, _FILLED = 36.0, 0.4

_ROUNDS = 16  # of ``place_head`` at most; yaw 60 before a phone at 3.6 units needs 6
_CLOSE_ENOUGH = 1e-3  # pixels


@dataclass(frozen=True)
class Pose:
    """How a head stands before the camera.

    Attributes:
        yaw, pitch: degrees about the head's up axis (positive turns it to the image right) and about the
            image's x axis (positive looks down).
        roll: degrees in the image plane, counter-clockwise, after the eyes were brought to the horizontal.
        scale: factor on the canonical eye distance.
        shift: pixels (x right, y down) of the canonical frame.
        distance: of the camera, scene units.
    """

    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    scale: float = 1.0
    shift: tuple[float, float] = (0.0, 0.0)
    distance: float = 12.0

    @staticmethod
    def sample(rng: np.random.Generator, head: HeadSpec, camera: CameraSpec) -> Pose:
        """A pose within the limits of a scene.

        Yaw and pitch have the density of a triangle, because photographs show most people from the front;
        roll, scale and shift are uniform, the focal length is in its logarithm.
        """
        yaw, pitch = rng.triangular(-1.0, 0.0, 1.0, 2)
        roll, scale, right, down = rng.uniform(-1.0, 1.0, 4)
        return Pose(
            yaw=float(head.yaw * yaw),
            pitch=float(head.pitch * pitch),
            roll=float(head.roll * roll),
            scale=float(1.0 + head.scale_jitter * scale),
            shift=(float(head.shift_jitter * right), float(head.shift_jitter * down)),
            distance=_sample_distance(rng, camera),
        )

    def camera(self, camera: CameraSpec) -> CameraSpec:
        """The camera that sees this pose: a scene's, at the pose's distance."""
        return replace(camera, distance=self.distance, focal=None)


def camera_distance(focal: float) -> float:
    """Scene units from which a focal length (mm on 36 x 24 mm film) shows the canonical frame as wide as
    ``_FILLED`` of the film; longer lenses stand farther away and flatten the face."""
    return 2.0 * focal / (_FILLED * _FILM)


def rotation_matrix(yaw: float, pitch: float) -> Array:
    """(3, 3) rotation: first yaw about y, then pitch about x; degrees."""
    a, b = np.radians([yaw, pitch])
    about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return np.asarray(about_x @ about_y)


def project_points(points: Array, camera: CameraSpec) -> Array:
    """Pixels (x right, y down) of the canonical 128 x 128 frame at which points (..., 3) are seen."""
    depth = camera.distance - points[..., 2:3]
    seen = points[..., :2] * (camera.distance / depth)
    return np.asarray(FACE_SIZE / 2 + _PIXELS_PER_UNIT * seen * (1.0, -1.0))


def place_head(points: Array, eyes: Array, pose: Pose, camera: CameraSpec) -> Array:
    """Turn points about the middle of the eyes, bring that to its pixel and the eyes to one line.

    The head's size is that at which the eyes, if they were equally far away, would be seen as far apart as in
    the canonical frame. Only heads turned sideways differ from photographs aligned by both eyes: those would
    be magnified by 1 / cos(yaw), which cuts mouth and chin off.

    Args:
        points: (N, 3) head, y up, z forward, any unit.
        eyes: (2, 3) eye centres, image left first, same unit.
        pose: the pose.
        camera: gives the perspective; ``pose.camera(...)`` for a sampled pose.

    Returns:
        (N, 3) in scene units. With yaw 0 both eyes project to the pose's similarity transform of the
        canonical eye centres within 0.001 pixel; with any yaw their middle and their line do.

    Raises:
        InputError: if the camera is so close that no size of the head does that.
    """
    middle = eyes.mean(axis=0)
    turn = rotation_matrix(pose.yaw, pose.pitch)
    points, eyes = (points - middle) @ turn.T, (eyes - middle) @ turn.T
    target = _eye_target(pose)
    across = target[1] - target[0]
    for _ in range(_ROUNDS):  # perspective makes it slightly nonlinear; each round divides the error
        seen = _as_complex(project_points(eyes, camera))
        line = (seen[1] - seen[0]) / abs(seen[1] - seen[0])
        factor = across / (line * _facing_distance(eyes, camera))
        offset = (target - seen).mean()
        if max(abs(offset), abs(across) * abs(1 - factor)) < _CLOSE_ENOUGH:
            return points
        points, eyes = _similarity(points, factor), _similarity(eyes, factor)
        offset = (target - _as_complex(project_points(eyes, camera))).mean()
        shift = np.array([offset.real, -offset.imag, 0.0]) / _PIXELS_PER_UNIT
        points, eyes = points + shift, eyes + shift
    raise InputError(
        f"pose: yaw {pose.yaw:g} at camera.distance {camera.distance:g} found, at which the eyes cannot be "
        "brought to their places; move the camera away"
    )


def _facing_distance(eyes: Array, camera: CameraSpec) -> float:
    """Pixels between the eyes if both were as far from the camera as their middle is."""
    apart, depth = np.linalg.norm(eyes[1] - eyes[0]), camera.distance - eyes[:, 2].mean()
    return float(_PIXELS_PER_UNIT * apart * camera.distance / depth)


def _sample_distance(rng: np.random.Generator, camera: CameraSpec) -> float:
    if camera.focal is None:
        return camera.distance
    return camera_distance(float(np.exp(rng.uniform(*np.log(camera.focal)))))


def _eye_target(pose: Pose) -> npt.NDArray[np.complex128]:
    """Both eye centres (x + i y, y down) after the pose's roll, scale and shift about the image centre."""
    centre = complex(FACE_SIZE / 2, FACE_SIZE / 2)
    eyes = np.array([complex(*EYE_IMAGE_LEFT), complex(*EYE_IMAGE_RIGHT)])
    turned = (eyes - centre) * pose.scale * np.exp(-1j * np.radians(pose.roll))
    return np.asarray(centre + turned + complex(*pose.shift))


def _similarity(points: Array, factor: complex) -> Array:
    """Scale all axes by |factor| and turn by its angle (pixels run y down, points y up)."""
    scale, angle = abs(factor), -np.angle(factor)
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(scale * points @ turn.T)


def _as_complex(pixels: Array) -> npt.NDArray[np.complex128]:
    return np.asarray(pixels[..., 0] + 1j * pixels[..., 1])
