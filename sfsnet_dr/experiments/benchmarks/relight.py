"""``sfsnet-dr bench relight``: errors of relit faces against path-traced ones, by cause.

Noise is in no number: an error is a mean product of two differences, each of a relit image and a reference
that share no random number with the other pair.

The same light means: after hard lights were moved to, or softened away from, the directions that a face has
responses to, as all lights of the datasets are (``scene.light_sources``).
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core import provenance
from sfsnet_dr.core.config import fingerprint
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import atomic_path, output_dir
from sfsnet_dr.core.visualize import on_white, png_bytes, show_linear
from sfsnet_dr.data.generate import dataset_identity
from sfsnet_dr.metrics.bootstrap import bootstrap_interval
from sfsnet_dr.render.aovs import TransportMaps, TransportOptions, render_aovs
from sfsnet_dr.render.path_tracer import path_trace
from sfsnet_dr.render.transport_shading import ResponseWeights, relight_responses, response_weights
from sfsnet_dr.report.html import Block, Gallery, KeyNumbers, Note, Section, Table, write_page
from sfsnet_dr.report.record import Record, make_record, write_records
from sfsnet_dr.scene.faces.face import sample_face
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import MAP_ORDER, Light
from sfsnet_dr.scene.lights.sampling import sample_direction, sample_scene_light
from sfsnet_dr.scene.lights.spec import LightKind, LightSpec
from sfsnet_dr.scene.mesh import Mesh
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.scene_cache import SceneCache
from sfsnet_dr.scene.spec import FACE_SHAPES, CameraSpec, SceneSpec
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.projection import equirect_directions

Array = npt.NDArray[np.float64]

#: Kinds of light, one a face each; maps of files where the scene names a folder.
KINDS: Final[tuple[LightKind, ...]] = ("hdr", "sun_sky", "studio", "directional", "ambient")

#: What is measured, in the order of ``FaceErrors.squared``: the whole error, its causes, and the noise of one
#: relit image. ``truncation`` is light beyond order 4, ``bounces`` light over further surface points than are
#: traced, ``gloss`` the mirror image of the light of order 4 held by order 2, ``rest`` everything else.
PARTS: Final = ("total", "truncation", "bounces", "gloss", "rest", "noise")

_DIRECTIONS, _LIGHT = 17, 18  # random streams


@dataclass(frozen=True, eq=False)
class _View:
    """What stays while lights change: a face, the camera, the seed of the noise."""

    mesh: Mesh
    camera: CameraSpec
    seed: int

    def black(self) -> _View:
        """The face with a black body: nothing but gloss is left."""
        return replace(self, mesh=replace(self.mesh, albedo=np.zeros_like(self.mesh.albedo)))


@dataclass(frozen=True, eq=False)
class FaceErrors:
    """One face under its lights.

    Attributes:
        squared: (lights, len(PARTS)) squared errors relative to the mean square of the path-traced image over
            the face. Unbiased estimates: they may be negative. The causes' need not sum to the total's.
        relit, traced: (lights, H, W, 3) the two images, linear.
        coverage: (H, W).
    """

    squared: Array
    relit: npt.NDArray[np.float32]
    traced: npt.NDArray[np.float32]
    coverage: npt.NDArray[np.float32]


class RelightBenchmark:
    """Measures faces one after another.

    Args:
        spec: of the faces; ``sampling.reference_spp`` is the paths per pixel of each reference.
        kinds: a light of each is drawn for every face.
    """

    def __init__(self, spec: SceneSpec, kinds: Sequence[LightKind]) -> None:
        self._spec, self._kinds = spec, kinds
        self._scenes = SceneCache(capacity=16)  # of all kinds of lights, with and without gloss

    def measure(self, seed: int) -> FaceErrors:
        """The face of a seed."""
        spec, face = self._spec, sample_face(seed, self._spec)
        view = _View(face.mesh, face.pose.camera(spec.camera), seed)
        directions = _directions(seed, spec.sampling.directional_lights)
        options = TransportOptions(MAP_ORDER, spec.sampling.max_bounces, spec.sampling.paths_per_hit)
        scene = self._show(view, Light("white", np.ones((*MAP_SIZE, 3))), spec.has_gloss)
        pair = [render_aovs(scene, spec.sampling.spp, 2 * seed + k, options, directions) for k in range(2)]
        black, found = view.black(), []
        for number, kind in enumerate(KINDS):
            if kind in self._kinds:
                rng = np.random.default_rng((seed, _LIGHT, number))
                light = _light(_lights_of(spec), kind, rng, directions)
                found.append(self._measure(pair, directions, light, view, black))
        squared, relit, traced = (np.stack(column) for column in zip(*found, strict=True))
        return FaceErrors(squared, relit.astype(np.float32), traced.astype(np.float32), pair[0].coverage)

    def _measure(
        self, pair: Sequence[TransportMaps], directions: Array, light: Light, view: _View, black: _View
    ) -> tuple[Array, Array, Array]:
        """Squared errors (len(PARTS),) under one light, and the two images."""
        weights, depth = response_weights(light, directions, MAP_ORDER), self._spec.sampling.max_bounces + 2
        relit = [relight_responses(maps.transport, maps.gloss, maps.directional, weights) for maps in pair]
        traced, cut = (self._trace(view, light, end) for end in (-1, depth))
        smooth, gloss, mirror = cut, [np.zeros_like(relit[0])] * 2, [np.zeros_like(relit[0])] * 2
        if light.environment is not None:
            smooth = self._trace_smooth(view, light, depth)
            if self._spec.has_gloss:
                gloss = [_gloss(maps, weights) for maps in pair]
                mirror = self._trace_smooth(black, replace(light, directional=()), 2)
        inside = pair[0].mask > 0

        def squared(one: Sequence[Array], other: Sequence[Array]) -> float:
            return float(((one[0] - other[0]) * (one[1] - other[1]))[inside].mean())

        found = {
            "total": squared(relit, traced),
            "truncation": squared(smooth, cut),
            "bounces": squared(cut, traced),
            "gloss": squared(gloss, mirror),
            "rest": squared(_less(relit, gloss), _less(smooth, mirror)),
            "noise": float(((relit[0] - relit[1]) ** 2)[inside].mean()) / 2,
        }
        power = float((traced[0] * traced[1])[inside].mean())
        return np.array([found[part] for part in PARTS]) / power, relit[0], (traced[0] + traced[1]) / 2

    def _show(self, view: _View, light: Light, gloss: bool) -> SurfaceScene:
        return self._scenes.show(view.mesh, view.camera, light, gloss=gloss)

    def _trace(self, view: _View, light: Light, depth: int) -> list[Array]:
        """Two images of independent noise; other lights and depths share it as far as paths are the same."""
        scene, samples = self._show(view, light, self._spec.has_gloss), self._spec.sampling.reference_spp
        return [path_trace(scene, samples, 2 * view.seed + k, depth).mean for k in range(2)]

    def _trace_smooth(self, view: _View, light: Light, depth: int) -> list[Array]:
        """The same with the environment's expansion in place of the environment.

        Where the expansion is negative it is no light: there its opposite is traced and taken away.
        """
        texels = sh_basis(equirect_directions(*MAP_SIZE), MAP_ORDER)
        expansion = texels @ light.environment_coefficients(MAP_ORDER).values
        images = self._trace(view, replace(light, environment=np.maximum(expansion, 0.0)), depth)
        if expansion.min() < 0:
            below = Light("negative", np.maximum(-expansion, 0.0))
            images = _less(images, self._trace(view, below, depth))
        return images


def _directions(seed: int, count: int) -> Array:
    rng = np.random.default_rng((seed, _DIRECTIONS))
    return np.array([sample_direction(rng) for _ in range(count)]).reshape(-1, 3)


def _lights_of(spec: SceneSpec) -> LightSpec:
    return spec.light or LightSpec()


def _light(spec: LightSpec, kind: LightKind, rng: np.random.Generator, directions: Array) -> Light:
    only = {name: float(name == kind) for name in (*KINDS, "lobes")}
    return sample_scene_light(rng, replace(spec, **only), directions)  # type: ignore[arg-type]


def _gloss(maps: TransportMaps, weights: ResponseWeights) -> Array:
    """What the relit image holds of the light's mirror image."""
    return np.asarray(np.einsum("khw,kc->hwc", maps.gloss, weights.radiance[: len(maps.gloss)]))


def _less(images: Sequence[Array], others: Sequence[Array]) -> list[Array]:
    return [image - other for image, other in zip(images, others, strict=True)]


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
        spec: of the faces; ``sampling.reference_spp`` is the paths per pixel of each reference. Without
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
        InputError: for a scene without faces, or a folder with faces measured otherwise.
    """
    if spec.shape not in FACE_SHAPES:
        raise InputError(
            f"{spec.name}: shape {spec.shape!r} found, one of {', '.join(FACE_SHAPES)} is needed"
        )
    if faces < 1 or seed < 0:
        raise InputError(f"bench relight: {faces} faces from seed {seed} found, at least 1 and 0 are needed")
    if spec.sampling.reference_spp < 2:
        raise InputError(f"bench relight: {spec.sampling.reference_spp} paths found, at least 2 are needed")
    kinds = [kind for kind in KINDS if kind != "hdr" or _lights_of(spec).environments is not None]
    folder, key = output_dir(out), fingerprint(dataset_identity(spec))
    measure, found = RelightBenchmark(spec, kinds), []
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
        make_record(
            what, root_mean(squared), "1", interval=_interval(squared, seed), command=command, seed=seed
        )
        for what, squared in values.items()
    ]


def root_mean(squared: Array) -> float:
    """Root of the mean of unbiased estimates of squares; 0 where it is negative."""
    return float(np.sqrt(max(float(squared.mean()), 0.0)))


def _interval(squared: Array, seed: int) -> tuple[float, float] | None:
    return bootstrap_interval(squared, root_mean, seed=seed) if len(squared) > 1 else None


def _store(path: Path, errors: FaceErrors, key: str) -> None:
    with atomic_path(path) as partial, partial.open("wb") as file:
        np.savez(file, key=np.array(key), **vars(errors))


def _load(path: Path, key: str) -> FaceErrors:
    try:
        with np.load(path) as file:
            found = {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: damaged ({error}); delete it, and it is measured again") from error
    if str(found.pop("key", "")) != key:
        raise InputError(f"{path}: measured with another scene or other samples; choose another folder")
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
        f"Transport: {sampling.spp} camera rays a pixel, {sampling.paths_per_hit} diffuse and as many glossy "
        f"paths each, {sampling.max_bounces} further surface points. References: {sampling.reference_spp} "
        f"paths a pixel, any number of surface points, {spec.camera.size} x {spec.camera.size} pixels. Noise "
        "is that of one relit image.",
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
