"""``sfsnet-dr bench relight``: relit faces against path-traced ones as records and a page, face by face."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.apply.display import on_white, png_bytes, show_linear
from sfsnet_dr.base import provenance
from sfsnet_dr.base.atomic import atomic_path, output_dir
from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.base.config import fingerprint
from sfsnet_dr.data.synth import identity
from sfsnet_dr.metrics.bootstrap import interval
from sfsnet_dr.report.html import Block, Gallery, KeyNumbers, Note, Section, Table, write_page
from sfsnet_dr.report.record import Record, measured, write_records
from sfsnet_dr.scene.light_spec import LightKind
from sfsnet_dr.scene.spec import FACE_SHAPES, SceneSpec
from sfsnet_dr.study.relight_truth import KINDS, PARTS, FaceErrors, RelitFaces

Array = npt.NDArray[np.float64]

CAUSES: Final = PARTS[1:-1]

_NAMES: Final = {
    "hdr": "photographed surroundings",
    "sun_sky": "sun and sky",
    "studio": "studio panels",
    "directional": "hard lamps",
    "ambient": "a dome of light",
}


def bench_relight(
    spec: SceneSpec,
    out: Path | str,
    *,
    faces: int = 20,
    seed: int = 0,
    command: str = "sfsnet-dr bench relight",
    on_face: Callable[[], None] = lambda: None,
) -> list[Record]:
    """Measure relit images against the path tracer; about a minute a face.

    What is known of each face is kept in the folder as soon as it is there: a run that was cut off, or that
    is to have more faces, goes on.

    Args:
        spec: of the faces; ``sampling.reference`` is the paths per pixel of each reference. Without
            ``light.environments`` kind ``"hdr"`` is left out.
        out: folder; it gets ``records.json``, ``index.html`` and ``face-NNNNNN.npz``.
        faces: how many, from ``seed`` on.
        seed: of the first face.
        command: what the records say measured them.
        on_face: called when a face is measured.

    Returns:
        ``relight.rel_rmse`` over all faces and lights, that of each kind of light, and the share of each
        cause, with intervals over faces.

    Raises:
        BadInput: for a scene without faces, or a folder with faces measured otherwise.
    """
    if spec.shape not in FACE_SHAPES:
        raise BadInput(f"{spec.name}: shape {spec.shape!r} found, one of {', '.join(FACE_SHAPES)} is needed")
    if faces < 1 or seed < 0:
        raise BadInput(f"bench relight: {faces} faces from seed {seed} found, at least 1 and 0 are needed")
    if spec.sampling.reference < 2:
        raise BadInput(f"bench relight: {spec.sampling.reference} paths found, at least 2 are needed")
    kinds = [kind for kind in KINDS if kind != "hdr" or spec.light.environments is not None]
    folder, key = output_dir(out), fingerprint(identity(spec))
    measure, found = RelitFaces(spec, kinds), []
    for face in range(seed, seed + faces):
        path = folder / f"face-{face:06d}.npz"
        errors = _load(path, key) if path.exists() else measure.measure(face)
        if not path.exists():
            _store(path, errors, key)
        found.append(errors)
        on_face()
    table = np.stack([errors.squared for errors in found])
    records = to_records(table, kinds, command, seed)
    write_records(folder / "records.json", records)
    _write_page(folder / "index.html", spec, found[0], table, kinds)
    return records


def to_records(table: Array, kinds: Sequence[LightKind], command: str, seed: int) -> list[Record]:
    """Records of squared errors (faces, kinds, len(PARTS)): roots of means, 0 where a mean is negative."""
    total = table[..., PARTS.index("total")]
    values = {"relight.rel_rmse": total.mean(axis=1)}
    values |= {f"relight.{kind}.rel_rmse": total[:, k] for k, kind in enumerate(kinds)}
    for part in (*CAUSES, "noise"):
        column = table[..., PARTS.index(part)]
        values[f"relight.cause.{part}" if part in CAUSES else f"relight.{part}"] = column.mean(axis=1)
        if part in CAUSES:
            values |= {f"relight.{kind}.cause.{part}": column[:, k] for k, kind in enumerate(kinds)}
    return [
        measured(what, root_mean(squared), "1", interval=_interval(squared, seed), command=command, seed=seed)
        for what, squared in values.items()
    ]


def root_mean(squared: Array) -> float:
    """Root of the mean of unbiased estimates of squares; 0 where it is negative."""
    return float(np.sqrt(max(float(squared.mean()), 0.0)))


def _interval(squared: Array, seed: int) -> tuple[float, float] | None:
    return interval(squared, root_mean, seed=seed) if len(squared) > 1 else None


def _store(path: Path, errors: FaceErrors, key: str) -> None:
    with atomic_path(path) as partial, partial.open("wb") as file:
        np.savez(file, key=np.array(key), **vars(errors))


def _load(path: Path, key: str) -> FaceErrors:
    try:
        with np.load(path) as file:
            found = {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise BadInput(f"{path}: damaged ({error}); delete it, and it is measured again") from error
    if str(found.pop("key", "")) != key:
        raise BadInput(f"{path}: measured with another scene or other samples; choose another folder")
    return FaceErrors(**found)


def _write_page(
    path: Path, spec: SceneSpec, first: FaceErrors, table: Array, kinds: Sequence[LightKind]
) -> None:
    total = table[..., PARTS.index("total")].mean(axis=1)
    ends = _interval(total, 0)
    between = f", with 95 % confidence {_percent(ends[0])} to {_percent(ends[1])}" if ends else ""
    lead = (
        f"Images of {len(table)} faces, put together from their light transport, differ from images "
        f"path-traced under the same lights by {_percent(root_mean(total))} (relative RMS error{between})."
    )
    numbers = [(_percent(root_mean(table[..., PARTS.index(cause)])), _CAUSE[cause]) for cause in CAUSES]
    sections = [
        Section("Why they differ", [KeyNumbers(numbers), *_explained(spec), _table(table, kinds)]),
        Section("One face under each light", [_gallery(first, kinds)]),
    ]
    footer = ", ".join(f"{name} {version}" for name, version in provenance.versions().items())
    write_page(path, "Relit against path-traced", lead, sections, footer=footer)


_CAUSE: Final = {
    "truncation": "surroundings held by harmonics of order 4",
    "bounces": "light over more surface points than are traced",
    "gloss": "mirror image of the surroundings held by order 2",
    "rest": "everything else",
}


def _explained(spec: SceneSpec) -> list[Block]:
    sampling = spec.sampling
    return [
        "All numbers are free of noise: each is a mean product of two differences, of two relit images and "
        "two path-traced ones with independent random numbers. So a cause that is 0 may come out a little "
        "above, and is shown as 0 where it comes out below. Squares of the causes add up to that of the "
        "whole only as far as the causes have nothing to do with each other.",
        f"Transport: {sampling.transport} camera rays a pixel, {sampling.paths} diffuse and as many glossy "
        f"paths each, {sampling.bounces} further surface points. References: {sampling.reference} paths a "
        f"pixel, any number of surface points, {spec.camera.size} x {spec.camera.size} pixels. Noise is that "
        "of one relit image.",
        Note(
            "Hard lights stand where the face's transport has a response to them, or are made soft, before "
            "either image is made, as in all lights that datasets are relit with. What that changes about a "
            "photographed sky is not counted here."
        ),
    ]


def _table(table: Array, kinds: Sequence[LightKind]) -> Table:
    def row(name: str, squared: Array) -> list[str]:
        return [name, *(_percent(root_mean(squared[..., k])) for k in range(len(PARTS)))]

    rows = [row(_NAMES[kind], table[:, k]) for k, kind in enumerate(kinds)]
    return Table(
        ["light", "whole error", *PARTS[1:]],
        [*rows, row("all", table)],
        "Relative RMS over the face's pixels and all faces.",
    )


def _gallery(first: FaceErrors, kinds: Sequence[LightKind]) -> Gallery:
    pictures = []
    for k, kind in enumerate(kinds):
        for name, image in (("relit", first.relit[k]), ("path-traced", first.traced[k])):
            picture = on_white(show_linear(image), first.coverage)
            pictures.append((png_bytes(picture), f"{_NAMES[kind]}, {name}"))
    return Gallery(pictures, "Left of each pair by transport, right path-traced.")


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.2f} %"
