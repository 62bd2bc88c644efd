"""Photographs whose truth photometric stereo found: Extended Yale B, Photoface, or labels made before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.data.databases import multipie, yale_b
from sfsnet_dr.data.databases.base import Listing
from sfsnet_dr.data.normal_labels import NormalLabels
from sfsnet_dr.experiments.evaluation.samples import SATURATED, Collection, EvaluationSample

Array = npt.NDArray[np.float64]

#: The lights of the 19-way classification by database.
FEW: Final[dict[str, tuple[str, ...]]] = {
    yale_b.NAME: yale_b.LIGHTS_19,
    multipie.NAME: multipie.LIGHTS_19,
}
TRUTH: Final = (
    "Normals and albedo are those that photometric stereo finds with all lights of a person; the lights' "
    "directions are the rig's."
)

#: A pixel that a light should reach (cosine above the first number) and that has less than the second of what
#: it should have is in a cast shadow.
_REACHED, _SHADOWED = 0.1, 0.5
#: A pixel shines if it has this share of its albedo more than a matt one.
_SHINES: Final = 0.25
#: Confidence from which on the truth is called sure: its normals have a standard error below 1.7 degrees.
_SURE: Final = 0.9


def labelled_samples(
    database: str,
    faces: Sequence[NormalLabels],
    skipped: Mapping[str, str],
    lights: Sequence[str] | None = None,
    listing: Listing | None = None,
) -> Collection:
    """Every photograph of labelled faces.

    Args:
        database: whose they are.
        faces: with their truth.
        skipped: what the labelling left out, with reasons.
        lights: names of those that take part; all if not given.
        listing: the photographs that they were made of, if at hand.
    """
    shots = [
        _shot(face, row)
        for face in faces
        for row, name in enumerate(face.lights)
        if lights is None or name in lights
    ]
    return Collection(database, shots, TRUTH, FEW.get(database, ()), skipped, listing)


def _shot(face: NormalLabels, row: int) -> EvaluationSample:
    direction = face.direction[row].double().numpy()
    return EvaluationSample(
        name=face.files[row],
        subject=face.subject,
        capture=face.name,
        image=face.images[row],
        mask=face.mask,
        shown=convex_hull_mask(face.mask[0].numpy()),
        grey=face.image.shape[1] == 1,
        light=face.lights[row],
        direction=direction / np.linalg.norm(direction),
        normal=face.normal,
        albedo=face.albedo.expand(3, -1, -1),
        sure=face.confidence[0].numpy() >= _SURE,
        causes=light_causes(face, row),
    )


def light_causes(face: NormalLabels, row: int) -> dict[str, float]:
    """How the picture departs from a matt face without shadows, by the face's own normals and albedo.

    Percent of the skin turned away from the light, in a cast shadow, and shining or saturated; the light's
    angle from the viewer's direction, and how unsure the truth is, percent.
    """
    skin = face.mask[0].numpy() > 0.5
    direction = face.direction[row].double().numpy()
    direction = direction / np.linalg.norm(direction)
    cosine = np.tensordot(direction, face.normal.double().numpy()[:, skin], 1)
    full = face.albedo.double().mean(0).numpy()[skin] * float(face.gain[row])
    value = face.image[row].double().mean(0).numpy()[skin]
    matt = full * np.maximum(cosine, 0)
    cast = (cosine > _REACHED) & (value < _SHADOWED * matt)
    shining = ((cosine > 0) & (value > matt + _SHINES * full)) | (value >= SATURATED)
    return {
        "turned away": 100 * float((cosine <= 0).mean()),
        "cast shadow": 100 * float(cast.mean()),
        "gloss": 100 * float(shining.mean()),
        "light (deg)": float(np.degrees(np.arccos(np.clip(direction[2], -1, 1)))),
        "truth unsure": 100 * float(1 - face.confidence[0].numpy()[skin].mean()),
    }


def convex_hull_mask(mask: npt.NDArray[np.floating]) -> Array:
    """The convex hull of a mask (H, W): all of a face that its photograph shows, eyes included, as 0 and 1.

    A crop's repeated borders lie outside of it.
    """
    from skimage.morphology import convex_hull_image

    return np.asarray(convex_hull_image(mask > 0.5), np.float64)  # type: ignore[no-untyped-call]
