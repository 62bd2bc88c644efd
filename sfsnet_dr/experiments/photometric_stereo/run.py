"""Compute normal labels from image sets, write them, and record how good they are."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import torch

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import output_dir
from sfsnet_dr.core.visualize import on_white, show_albedo, show_linear, show_normals
from sfsnet_dr.data.databases.base import Listing
from sfsnet_dr.data.normal_labels import NormalLabels, write_index, write_normal_labels
from sfsnet_dr.estimation.light_intensities import LightImages, LightIntensities, estimate_light_intensities
from sfsnet_dr.estimation.photometric_stereo import FEWEST, Surface, photometric_stereo, unit_directions
from sfsnet_dr.experiments.photometric_stereo.captures import ImageSet, ImageSets
from sfsnet_dr.metrics.bootstrap import bootstrap_interval
from sfsnet_dr.metrics.normals import angles_deg
from sfsnet_dr.report.record import Record, dotted_word, make_record

Array = npt.NDArray[np.float64]

#: Pixels below this confidence are no ground truth and leave the mask.
LEAST_CONFIDENCE: Final = 0.5
#: Pixels of a capture from which the lamps' strengths are estimated.
_SAMPLED: Final = 350


@dataclass(frozen=True, eq=False)
class LabelledSet:
    """What came out.

    Attributes:
        labels: of each capture.
        halves: mean angle (degrees) between the normals of two disjoint halves of each capture's lights;
            NaN with fewer than eight.
        raw_halves: the same with all lamps taken to be equal.
        kept: share of each capture's skin that is sure enough.
        strobes: of all captures.
        skipped: photographs and captures that are not in it, with the reason.
    """

    labels: list[NormalLabels]
    halves: list[float]
    raw_halves: list[float]
    kept: list[float]
    strobes: LightIntensities
    skipped: dict[str, str] = field(default_factory=dict)


def compute_normal_labels(
    read: ImageSets,
    out: Path | str | None = None,
    *,
    halves: bool = True,
    on_capture: Callable[[], object] = lambda: None,
) -> LabelledSet:
    """Photometric stereo of every capture with at least four known lights.

    Args:
        read: of a database whose lights are known.
        out: folder for the labels, made if missing; None writes nothing.
        halves: whether each capture is solved again from halves of its lights.
        on_capture: called after each.

    Raises:
        InputError: if no capture has four usable lights, or ``out`` cannot be written to.
    """
    listing, skipped, captures = read.listing, dict(read.skipped), []
    for face in read.faces:
        try:
            captures.append(_usable(face))
        except InputError as error:
            skipped[face.name] = str(error)
    if not captures:
        first = next(iter(skipped.items()), ("it", "no lights known"))
        raise InputError(f"{listing.folder}: no capture with {FEWEST} usable lights; {first[0]}: {first[1]}")
    strobes = estimate_light_intensities([_shots(capture) for capture in captures])
    result = LabelledSet([], [], [], [], strobes, skipped)
    folder = None if out is None else output_dir(out)
    written = {}
    for capture in captures:
        gains = strobes.gains(capture.lamps, capture.directions)
        surface = photometric_stereo(capture.images, capture.directions, gains, capture.mask)
        sure = capture.mask * (surface.confidence >= LEAST_CONFIDENCE)
        if not (sure > 0.5).any():
            skipped[capture.name] = "no pixel of its normals is sure enough"
            continue
        labels = _labels(capture, surface, sure, gains)
        result.labels.append(labels)
        result.kept.append(float(sure.sum() / capture.mask.sum()))
        result.halves.append(_halves(capture, gains, sure) if halves else float("nan"))
        result.raw_halves.append(_halves(capture, np.ones_like(gains), sure) if halves else float("nan"))
        if folder is not None:
            written[labels.name] = {"subject": labels.subject, "sha256": write_normal_labels(folder, labels)}
        on_capture()
    if not result.labels:
        raise InputError(f"{listing.folder}: no capture gave normals that are sure; are its lights right?")
    if folder is not None:
        told = {
            "oblique": strobes.oblique,
            "strength": dict(strobes.strength),
            "calibrated_by": listing.calibrated_by,
        }
        write_index(folder, listing.database, told, written, skipped)
        (folder / "sheet.png").write_bytes(normal_label_sheet(result.labels))
    return result


def normal_label_sheet(labels: Sequence[NormalLabels], most: int = 12) -> bytes:
    """Normals, albedo and confidence of some captures, as one PNG."""
    from sfsnet_dr.inference.sheet import draw_sheet

    cells = []
    for face in labels[:: max(1, len(labels) // most)][:most]:
        mask = face.mask[0].numpy()
        albedo = face.albedo.expand(3, -1, -1).permute(1, 2, 0).double().numpy()
        normal = face.normal.permute(1, 2, 0).double().numpy()
        sure = np.repeat(face.confidence[0].numpy()[..., None], 3, 2)
        pictures = {
            "normals": show_normals(normal),
            "albedo": show_albedo(albedo, mask),
            "confidence": show_linear(sure),
        }
        cells += [(f"{face.name}: {what}", on_white(picture, mask)) for what, picture in pictures.items()]
    return draw_sheet(cells, columns=6)


def _usable(capture: ImageSet) -> ImageSet:
    """The photographs whose lamp is known.

    Raises:
        InputError: with too few of them, or lamps in one plane.
    """
    known = capture.only([photo.direction is not None for photo in capture.photos])
    if len(known.photos) < FEWEST:
        raise InputError(f"{len(known.photos)} usable lights, at least {FEWEST} are needed")
    unit_directions(known.directions, len(known.photos))
    return known


def _shots(capture: ImageSet) -> LightImages:
    pixels = np.flatnonzero(capture.mask > 0.5)
    chosen = pixels[:: max(1, len(pixels) // _SAMPLED)]
    values = capture.images.mean(-1).reshape(len(capture.photos), -1)[:, chosen].T
    return LightImages(values, capture.directions, capture.lamps)


def _halves(capture: ImageSet, gains: Array, mask: Array) -> float:
    """Mean angle between the answers of every second light, in order of azimuth, and the others."""
    if len(capture.photos) < 2 * FEWEST:
        return float("nan")
    x, y, z = capture.directions.T
    order = np.lexsort((y, np.round(np.arctan2(x, z), 6)))
    try:
        first, second = (
            photometric_stereo(capture.images[half], capture.directions[half], gains[half], mask)
            for half in (order[::2], order[1::2])
        )
    except InputError:
        return float("nan")
    return float(angles_deg(first.normal, second.normal)[mask > 0.5].mean())


def _labels(capture: ImageSet, surface: Surface, mask: Array, gains: Array) -> NormalLabels:
    def tensor(values: Array) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(values, np.float32))

    return NormalLabels(
        name=capture.name,
        subject=capture.photos[0].subject,
        lights=capture.lamps,
        files=tuple(photo.name for photo in capture.photos),
        image=tensor(np.moveaxis(capture.images, -1, 1)),
        normal=tensor(np.moveaxis(surface.normal, -1, 0)),
        albedo=tensor(np.moveaxis(np.clip(surface.albedo, 0, 100), -1, 0)),
        mask=tensor(mask[None]),
        confidence=tensor(surface.confidence[None]),
        residual=tensor(np.clip(surface.residual, 0, 100)[None]),
        direction=tensor(capture.directions),
        gain=tensor(gains),
    )


def label_records(listing: Listing, found: LabelledSet, command: str) -> list[Record]:
    """``stereo.<database>.*``: captures, agreement of halves, gains, skipped files.

    ``halves_deg`` is the mean angle between the normals of two disjoint halves of each capture's lights,
    ``halves_equal_lamps_deg`` the same with all gains at 1; intervals are over captures.
    """
    head = f"stereo.{dotted_word(listing.database)}"

    def one(name: str, value: float, unit: str, ends: tuple[float, float] | None = None) -> Record:
        return make_record(f"{head}.{name}", value, unit, command=command, interval=ends)

    records = [one("captures", len(found.labels), "1"), one("skipped", len(found.skipped), "1")]
    sets = {"halves_deg": found.halves, "halves_equal_lamps_deg": found.raw_halves}
    for name, values in sets.items():
        known = [value for value in values if np.isfinite(value)]
        if known:
            records.append(one(name, float(np.mean(known)), "degrees", _ends(known)))
    deviation = [np.log(value) for value in found.strobes.strength.values()]
    if deviation:
        records.append(one("lamps_std", float(np.std(deviation)), "1"))
        records.append(one("lamps_disagreement", found.strobes.spread, "1"))
        records.append(one("oblique_gain", found.strobes.oblique, "1"))
    records.append(one("mask_kept", float(np.mean(found.kept)), "1", _ends(found.kept)))
    return records


def light_records(listing: Listing, errors: Mapping[str, float], command: str) -> list[Record]:
    """``stereo.<database>.lamps_found`` and ``lamps_found_deg``, the mean angle to where they are known."""
    head, values = f"stereo.{dotted_word(listing.database)}", list(errors.values())
    found = len({photo.light for photo in listing.photos if photo.direction is not None})
    records = [make_record(f"{head}.lamps_found", found, "1", command=command)]
    if values:
        mean = float(np.mean(values))
        records.append(
            make_record(f"{head}.lamps_found_deg", mean, "degrees", command=command, interval=_ends(values))
        )
    return records


def check_records(errors: Mapping[int, Array], command: str) -> list[Record]:
    """``stereo.rendered.lights<N>.mean_deg``: mean angle to the true normals, intervals over faces.

    ``stereo.rendered.lights<N>.equal_lamps_deg`` is the same without estimating gains, which here are equal.
    """
    return [
        make_record(
            f"stereo.rendered.lights{count}.{name}",
            float(values.mean()),
            "degrees",
            command=command,
            interval=_ends(list(values)),
        )
        for count, both in errors.items()
        for name, values in zip(("mean_deg", "equal_lamps_deg"), both.T, strict=True)
    ]


def _ends(values: Sequence[float]) -> tuple[float, float] | None:
    return tuple(bootstrap_interval(values)) if len(values) > 1 else None  # type: ignore[return-value]
