"""Rendered faces that no network was trained on, photographed under lights that none of them saw."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.dataset import Faces, RelitFaces, load_faces
from sfsnet_dr.data.manifest import Manifest
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.data.transforms.camera import PhotoOptions
from sfsnet_dr.experiments.evaluation.samples import Collection, EvaluationSample, picture_causes
from sfsnet_dr.metrics.light import light_direction
from sfsnet_dr.scene.lights.cache import draw_lights

NAME: Final = "synthetic"
TRUTH: Final = (
    "Normals, albedo and the light's coefficients are those of the renderer; the lights and cameras are "
    "drawn as `sfsnet-dr train` draws them by default, with colour in every picture."
)

#: Bundles that are held back, as the recipes of training do, and pictures of each.
HELD_BACK: Final = 100
_PICTURES: Final = 5
#: How the pictures vary.
OPTIONS: Final = Augmentation(photo=PhotoOptions(grayscale_prob=0.0))
_SEED: Final = 5_000_011
_LIGHTS: Final = 256
_BATCH: Final = 10


def synthetic_samples(
    folders: Sequence[Path], most: int, on_picture: Callable[[], object] = lambda: None
) -> Collection:
    """Pictures of the bundles that training holds back, each face as often as another.

    Args:
        folders: what ``sfsnet-dr synth`` wrote; the same ones as the networks' training had.
        most: no more pictures than these many.
        on_picture: called after each.
    """
    known = sum(len(Manifest(folder).entries) for folder in folders)
    held_back = min(HELD_BACK, (known - 1) // 2)
    faces = load_faces(folders, held_back=max(held_back, 0), held=held_back > 0)
    count = min(most, _PICTURES * len(faces))
    bank = draw_lights(OPTIONS.light, _LIGHTS, _SEED)
    size = min(_BATCH, count)
    source = RelitFaces(faces, size, OPTIONS, _SEED, bank)
    shots: list[EvaluationSample] = []
    for step in range(-(-count // size)):
        batch, indices = source.batch(step), source.indices(step)
        for row in range(min(size, count - len(shots))):
            shots.append(_shot(faces, indices[row], batch, row, len(shots)))
            on_picture()
    return Collection(NAME, shots, TRUTH)


def _shot(faces: Faces, index: int, batch: FaceBatch, row: int, number: int) -> EvaluationSample:
    light = batch.light[row].double().numpy()
    image, mask = batch.image[row], batch.mask[row]
    direction = light_direction(light[None])[0]
    angle = float(np.degrees(np.arccos(np.clip(direction[2], -1, 1))))
    normal = batch.normal[row].numpy()[:, mask[0].numpy() > 0.5].mean(1)
    turned = float(np.degrees(np.arctan2(np.hypot(normal[0], normal[1]), normal[2])))
    return EvaluationSample(
        name=f"{faces.names[index]}-{number}",
        subject=faces.names[index],
        capture=faces.names[index],
        image=image,
        mask=mask,
        shown=np.ones(tuple(mask.shape[1:])),
        direction=None,
        coefficients=light,
        normal=batch.normal[row],
        albedo=batch.albedo[row],
        causes={**picture_causes(image, mask), "light (deg)": angle, "turned (deg)": turned},
    )
