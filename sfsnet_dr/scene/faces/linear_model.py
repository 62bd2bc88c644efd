"""A face as a mean and modes, with the 68 landmarks that photographs are marked with: what a fit works on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import check_shape
from sfsnet_dr.scene.faces.ict import scaled_modes, to_common_frame
from sfsnet_dr.scene.faces.ict_files import read_ict
from sfsnet_dr.scene.faces.ict_regions import FACE, JAW, LANDMARKS, ict_regions
from sfsnet_dr.scene.faces.model import digest_of
from sfsnet_dr.scene.mesh import FACE_REGIONS, Region, triangulate

Array = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]
Indices = npt.NDArray[np.uint32]

#: Vertices that a landmark of the jaw may stand on, and half the width (decimetres) of the strip they are in.
OUTLINE_STEPS: Final = 16
_STRIP: Final = 0.03
#: A strip ends where the cheek faces the viewer: at this share of the way in to the middle of the face.
_STRIP_END: Final = 0.6


@dataclass(frozen=True, eq=False)
class FaceModes:
    """A linear model of the front of a head, in the common frame of ``scene.face_model``, decimetres.

    Attributes:
        digest: hash of the model's numbers.
        mean: neutral mean face, (V, 3).
        modes: offsets (M, V, 3): identities for normal coefficients of unit variance, then face units for
            weights from 0 to 1.
        identities: how many of the modes are identities.
        faces: (F, 3) triangles, counter-clockwise seen from outside.
        skin: (V,) 1 on skin of the face, lips and brows included.
        bare: (V,) 1 on skin of the face without lips, brows and lids.
        inner: vertices of landmarks 17 to 67 (iBUG 300-W order), (51,).
        outline: vertices that each landmark of the jaw may stand on, from the neutral face's outline inwards,
            (17, C): on a turned head the outline is nearer to the viewer.
    """

    digest: str
    mean: Array
    modes: Singles
    identities: int
    faces: Indices
    skin: Array
    bare: Array
    inner: npt.NDArray[np.int64]
    outline: npt.NDArray[np.int64]

    def __post_init__(self) -> None:
        sizes = check_shape("mean", self.mean, "V 3")
        check_shape("modes", self.modes, "M V 3", **sizes)
        check_shape("skin", self.skin, "V", **sizes)
        check_shape("bare", self.bare, "V", **sizes)
        check_shape("inner", self.inner, "51")
        check_shape("outline", self.outline, "17 C")

    def shape(self, weights: npt.ArrayLike) -> Array:
        """Vertices (V, 3) of a face with weights (M,)."""
        given = np.asarray(weights, np.float32)
        offsets = given @ self.modes.reshape(len(self.modes), -1)
        return np.asarray(self.mean + offsets.reshape(-1, 3), np.float64)


@cache
def load_face_modes(path: Path) -> FaceModes:
    """The front of ICT FaceKit's head (9,409 vertices, 100 identities, 57 face units).

    Args:
        path: the compact file, a clone, or its ``FaceXModel`` folder.

    Raises:
        InputError: for a missing, damaged or foreign file.
    """
    files = read_ict(path)
    mesh, scale = to_common_frame(files)
    front = np.arange(len(FACE))  # they come first
    quads = mesh.quads[(mesh.quads < len(FACE)).all(axis=1)]
    labels = ict_regions(mesh).labels()[front]
    modes = np.concatenate([scaled_modes(part, front, scale) for part in (files.identity, files.expression)])
    mean = mesh.neutral[front]
    return FaceModes(
        digest=digest_of(files.neutral, files.faces, files.identity, files.expression),
        mean=mean,
        modes=modes,
        identities=len(files.identity),
        faces=triangulate(quads),
        skin=np.isin(labels, FACE_REGIONS).astype(np.float64),
        bare=(labels == Region.SKIN).astype(np.float64),
        inner=LANDMARKS[JAW.stop :],
        outline=outline_strips(mean, LANDMARKS[JAW], LANDMARKS[JAW.stop :]),
    )


def outline_strips(
    mean: Array, jaw: npt.NDArray[np.int64], inner: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Vertices (17, C) from each vertex of the jaw toward the viewer, in the plane through it and the depth.

    Args:
        mean: (V, 3).
        jaw: (17,) vertices.
        inner: (51,) vertices of the other landmarks; their mean is the middle of the face.
    """
    middle = mean[inner].mean(axis=0)
    strips = []
    for vertex in jaw:
        outward = (mean[vertex] - middle)[:2]
        reach = float(np.linalg.norm(outward))
        along = (mean - middle)[:, :2] @ (outward / reach)
        across = (mean - middle)[:, :2] @ (np.array([-outward[1], outward[0]]) / reach)
        steps = reach * np.linspace(1.0, _STRIP_END, OUTLINE_STEPS)
        near = np.flatnonzero((np.abs(across) < _STRIP) & (mean[:, 2] >= mean[vertex, 2]))
        places = near[np.abs(along[near][None] - steps[1:, None]).argmin(axis=1)]
        strips.append(np.concatenate([[vertex], places]))
    return np.array(strips)
