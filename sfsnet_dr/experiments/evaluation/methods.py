"""Which methods are measured: baselines by name, and networks.

The 3DMM's protocol: one fit a capture, shared by its lights. Its landmarks are the median of those of the
capture's photographs under frontal light (within 25 degrees of the viewer), or of all whose lights are not
known: what a detector finds under one lamp from beside would be the detector's error, not the model's. So
its normals do not depend on the light; its light is fitted to each photograph.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from sfsnet_dr.core.errors import InputError, nearest
from sfsnet_dr.data.alignment import canonical_landmarks
from sfsnet_dr.data.databases.base import FacePhoto, Listing
from sfsnet_dr.data.photos import find_landmarks, read_landmarks
from sfsnet_dr.experiments.evaluation.samples import EvaluationSample
from sfsnet_dr.experiments.evaluation.splits import fine_tuning_split, fold_suffix
from sfsnet_dr.inference.baselines import MeanAlbedo, MeanNormals, ModelFit, OneAlbedo, ShadingSearch
from sfsnet_dr.inference.methods import FlatNormals, Method, NetworkMethod
from sfsnet_dr.models.shipped import weights_name
from sfsnet_dr.report.record import dotted_word
from sfsnet_dr.scene.faces.linear_model import load_face_modes

Array = npt.NDArray[np.float64]

#: Least z of the direction toward a frontal light.
_FRONTAL: Final = float(np.cos(np.radians(25)))


@dataclass(frozen=True)
class RequestedMethod:
    """What the command line asks for.

    Args:
        baselines: their names; all that can run if empty.
        weights: of networks.
        landmarks: file of landmarks in the photographs' pixels; looked for at the database if None.
        model_path: face model of the 3DMM.
        once: ask networks once for each photograph, see ``methods.ask``.
    """

    baselines: tuple[str, ...] = ()
    weights: tuple[Path, ...] = ()
    landmarks: Path | None = None
    model_path: Path | None = None
    once: bool = False


def methods_for(
    shots: Sequence[EvaluationSample], wanted: RequestedMethod, listing: Listing | None = None
) -> tuple[list[Method], dict[str, str]]:
    """The baselines, then a network for each file of weights, named by the file or its folder.

    Args:
        shots: that will be measured.
        wanted: see there.
        listing: the photographs before they were read, None where they are not known.

    Returns:
        The methods, and why each baseline is missing that was not asked for by name.

    Raises:
        InputError: for an unknown baseline, or one that was asked for and cannot run; for two methods of one
            name; for unusable weights.
    """
    makers: dict[str, Callable[[], Method]] = {
        FlatNormals.name: FlatNormals,
        MeanNormals.name: lambda: MeanNormals(_by_subject(shots, "normal")),
        OneAlbedo.name: lambda: OneAlbedo(_by_subject(shots, "normal")),
        MeanAlbedo.name: lambda: _mean_albedo(shots),
        ModelFit.name: lambda: _model_fit(shots, wanted, listing),
        ShadingSearch.name: ShadingSearch,
    }
    for name in wanted.baselines:
        if name not in makers:
            raise InputError(f"methods: {name!r} found; {nearest(name, makers)}")
    methods: list[Method] = []
    left_out: dict[str, str] = {}
    for name in wanted.baselines or makers:
        try:
            _add(methods, makers[name](), name)
        except InputError as error:
            if name in wanted.baselines:
                raise InputError(f"{name}: {error}") from error
            left_out[name] = str(error)
    for path in wanted.weights:
        name = dotted_word(weights_name(path))
        network = NetworkMethod(name, path, once=wanted.once)
        split = fine_tuning_split(network)
        if split is not None:
            network.name = name + fold_suffix(split)
        _add(methods, network, str(path))
    return methods, left_out


def _add(methods: list[Method], method: Method, source: str) -> None:
    if method.name in [other.name for other in methods]:
        raise InputError(f"weights: two methods would be called {method.name!r}; rename {source}")
    methods.append(method)


def _mean_albedo(shots: Sequence[EvaluationSample]) -> MeanAlbedo:
    colours = _by_subject(shots, "albedo")
    return MeanAlbedo(
        _by_subject(shots, "normal"), {name: each.mean(0, keepdim=True) for name, each in colours.items()}
    )


def _by_subject(shots: Sequence[EvaluationSample], kind: Literal["normal", "albedo"]) -> dict[str, Tensor]:
    """Maps that are known, means of each subject over its captures, 0 outside of their masks."""
    captures: dict[str, dict[str, Tensor]] = {}
    for shot in shots:
        known: Tensor | None = getattr(shot, kind)
        if known is not None and shot.capture not in captures.setdefault(shot.subject, {}):
            captures[shot.subject][shot.capture] = known * (shot.mask > 0.5)
    return {name: torch.stack(list(each.values())).mean(0) for name, each in captures.items() if each}


def _model_fit(
    shots: Sequence[EvaluationSample], wanted: RequestedMethod, listing: Listing | None
) -> ModelFit:
    if listing is None:
        raise InputError(
            "labels do not say where the photographs have the eyes; evaluate the database itself"
        )
    own = wanted.landmarks is None and all(photo.points is not None for photo in listing.photos)
    known = {} if own else read_landmarks(wanted.landmarks or find_landmarks(listing.folder))
    marks = capture_landmarks(listing, known)
    captures = sorted({shot.capture for shot in shots})
    missing = [name for name in captures if name not in marks]
    if missing:
        raise InputError(
            f"no landmarks of {missing[0]} ({len(missing)} of {len(captures)} captures have none)"
        )
    if wanted.model_path is None:
        raise InputError("a face model is needed; --model-path names ICT FaceKit")
    return ModelFit(load_face_modes(wanted.model_path), marks)


def capture_landmarks(listing: Listing, known: Mapping[str, Array]) -> dict[str, Array]:
    """Landmarks (68, 2) of each capture that has any, in the canonical frame; see this file's head.

    Args:
        listing: the photographs.
        known: landmarks in their pixels, by their path below the database's folder or by their file's name;
            a photograph's own ones stand for those that are not in it.
    """
    found = {}
    for capture, photos in listing.captures().items():
        marked = {
            photo.name: known.get(photo.name, known.get(photo.path.name, photo.points)) for photo in photos
        }
        usable = [photo for photo in photos if _is_whole(marked[photo.name])]
        frontal = [photo for photo in usable if _is_frontal(photo)]
        rows = [canonical_landmarks(np.asarray(marked[p.name]), p.eyes) for p in frontal or usable]
        if rows:
            found[capture] = np.asarray(np.median(rows, axis=0))
    return found


def _is_whole(points: Array | None) -> bool:
    return points is not None and bool(np.isfinite(points).all())


def _is_frontal(photo: FacePhoto) -> bool:
    return photo.direction is None or photo.direction[2] >= _FRONTAL
