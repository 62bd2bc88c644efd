"""``sfsnet-dr bench synth``: how fast faces are made, at what noise, against the plain way and the limit.

What ``sfsnet-dr bench synth`` measured, as a plot and a page. Reads records alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import atomic_path, output_dir
from sfsnet_dr.data.bundle import write_bundle
from sfsnet_dr.data.generate import render_bundle, render_file
from sfsnet_dr.experiments.benchmarks.common import bare_ray_tests, kernel_times
from sfsnet_dr.experiments.benchmarks.naive_rendering import (
    NaiveRender,
    measure_noise,
    render_naively,
    response_variances,
)
from sfsnet_dr.render.aovs import TransportMaps, TransportOptions, render_aovs
from sfsnet_dr.render.sobol import SAMPLERS, Sampler
from sfsnet_dr.report.html import Figure, KeyNumbers, Section, Table, write_page
from sfsnet_dr.report.plots import noise_plot
from sfsnet_dr.report.record import Record, make_record, write_records
from sfsnet_dr.scene.faces.face import Face, sample_face
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import MAP_ORDER
from sfsnet_dr.scene.lights.sampling import sample_direction
from sfsnet_dr.scene.mitsuba_scene import SurfaceScene
from sfsnet_dr.scene.spec import FACE_SHAPES, SceneSpec
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.projection import equirect_directions

Array = npt.NDArray[np.float64]
T = TypeVar("T")

#: Parts of the measurement.
STEPS = 4

#: Captures that noise is estimated from.
RUNS = 4
#: Camera rays a pixel for which noise and time are measured, for every sampler.
SAMPLE_COUNTS = (4, 16, 64)
#: Paths a pixel of the plain way's renders; their noise is scaled from there.
PLAIN_SAMPLES = 16


@dataclass(frozen=True)
class Bench:
    """What all measurements share: one face, its scene, and what is traced.

    Attributes:
        face: the face that is measured on.
        scene: with the face in it.
        spec: how it is sampled.
        directions: (D, 3) of its directional lights.
        seed: of face and noise.
    """

    face: Face
    scene: SurfaceScene
    spec: SceneSpec
    directions: Array
    seed: int

    @staticmethod
    def prepare(spec: SceneSpec, seed: int) -> Bench:
        """Sample the face and load its scene."""
        face = sample_face(seed, spec)
        scene = SurfaceScene(face.mesh, face.pose.camera(spec.camera), gloss=spec.has_gloss)
        rng = np.random.default_rng(seed)
        directions = np.array([sample_direction(rng) for _ in range(spec.sampling.directional_lights)])
        return Bench(face, scene, spec, directions.reshape(-1, 3), seed)

    def options(self, sampler: Sampler = "sobol") -> TransportOptions:
        """The spec's, for a sampler."""
        return TransportOptions(
            MAP_ORDER, self.spec.sampling.max_bounces, self.spec.sampling.paths_per_hit, sampler
        )

    def captures(self, samples: int, sampler: Sampler = "sobol") -> tuple[list[TransportMaps], float]:
        """Captures of independent seeds, and the median time of one, compiled and warm."""
        options = self.options(sampler)
        render_aovs(self.scene, samples, self.seed, options, self.directions)
        timed = [
            _timed(lambda k=k: render_aovs(self.scene, samples, self.seed + k, options, self.directions))  # type: ignore[misc]
            for k in range(RUNS)
        ]
        return [maps for maps, _ in timed], float(np.median([seconds for _, seconds in timed]))


def bench_synth(
    spec: SceneSpec,
    *,
    faces: int = 6,
    seed: int = 0,
    command: str = "sfsnet-dr bench synth",
    on_step: Callable[[], None] = lambda: None,
) -> list[Record]:
    """Measure bundles a second, noise against time, the ratio to the plain way and the share of the ray rate.

    All in one run, one after another; let nothing else run on the machine. Minutes.

    Args:
        spec: faces to render; its sampling is what is measured.
        faces: faces that bundles a second are measured on, after one that compiles.
        seed: of the first face.
        command: what the records say measured them.
        on_step: called after each of ``STEPS`` parts.

    Raises:
        InputError: for a scene without faces, or no face to measure on.
    """
    if spec.shape not in FACE_SHAPES:
        raise InputError(
            f"{spec.name}: shape {spec.shape!r} found, one of {', '.join(FACE_SHAPES)} is needed"
        )
    if faces < 1 or seed < 0:
        raise InputError(f"bench synth: {faces} faces from seed {seed} found, at least 1 and 0 are needed")
    found = _bundle_rate(spec, faces, seed)
    on_step()
    bench = Bench.prepare(spec, seed)
    for part in (_noise_against_time, _against_plain, _against_rays):
        found |= part(bench)
        on_step()
    return [
        make_record(f"synth.{name}", value, unit, command=command, seed=seed)
        for name, (value, unit) in found.items()
    ]


def _bundle_rate(spec: SceneSpec, faces: int, seed: int) -> dict[str, tuple[float, str]]:
    """Wall time of whole bundles, and of those of their parts that are not the transport."""
    data = render_file(spec, None, seed)  # loads the face model and compiles
    seconds = [_timed(lambda k=k: render_file(spec, None, seed + 1 + k))[1] for k in range(faces)]  # type: ignore[misc]
    shapes = [_timed(lambda k=k: sample_face(seed + 1 + k, spec))[1] for k in range(3)]  # type: ignore[misc]
    bundle = render_bundle(spec, seed)
    with TemporaryDirectory() as folder:
        files = [_timed(lambda: write_bundle(Path(folder) / "face.exr", bundle))[1] for _ in range(3)]
    return {
        "bundles_per_s": (len(seconds) / sum(seconds), "1/s"),
        "bundle_bytes": (len(data), "B"),
        "seconds.bundle": (float(np.median(seconds)), "s"),
        "seconds.sample_face": (float(np.median(shapes)), "s"),
        "seconds.write_file": (float(np.median(files)), "s"),
    }


def _noise_against_time(bench: Bench) -> dict[str, tuple[float, str]]:
    found = {}
    for sampler in SAMPLERS:
        for samples in SAMPLE_COUNTS:
            captures, seconds = bench.captures(samples, sampler)
            noise, key = measure_noise(captures), f"{sampler}.{samples}"
            found[f"noise.transport.{key}"] = (noise.transport, "1")
            if bench.scene.gloss:
                found[f"noise.gloss.{key}"] = (noise.gloss, "1")
            if len(bench.directions):
                found[f"noise.lamps.{key}"] = (noise.directional, "1")
            found[f"seconds.capture.{key}"] = (seconds, "s")
    return found


def _against_plain(bench: Bench) -> dict[str, tuple[float, str]]:
    """Time of the plain way at the same noise, and at the same number of paths, over that of a capture.

    The plain way loads the scene once a face, then renders each response alone. A basis light is negative in
    places, which no environment may be: its two parts are rendered with half the samples each, which has less
    noise than one render of a shifted light.
    """
    sampling = bench.spec.sampling
    captures, seconds = bench.captures(sampling.spp)
    ours, mask = response_variances(captures), captures[0].mask.astype(np.float64)
    scene, load = _timed(lambda: _loaded(bench))
    _, exchange = _timed(lambda: bench.scene.set_mesh(bench.face.mesh))
    depth, paths = sampling.max_bounces + 2, sampling.spp * sampling.paths_per_hit
    basis = sh_basis(equirect_directions(*MAP_SIZE), MAP_ORDER)
    equal_noise, equal_paths, needed_transport = load, load, []
    groups = [(scene, basis, depth, ours.transport)]
    if scene.gloss:
        groups.append((_mirror(bench), basis[..., :9], 2, ours.gloss))
    for surface, functions, deepest, variance in groups:
        for k in range(functions.shape[-1]):
            parts = [np.maximum(sign * functions[..., k], 0.0) for sign in (1.0, -1.0)]
            parts = [part for part in parts if part.any()]
            runs = [_plain(surface, part, mask, deepest) for part in parts]
            needed = sum(run.variance for run in runs) * len(runs) / variance
            if surface is scene:
                needed_transport.append(needed)
            equal_noise += _seconds_for(runs, needed)
            equal_paths += _seconds_for(runs, paths)
    for direction in bench.directions:
        lit = SurfaceScene(
            bench.face.mesh, bench.scene.camera, [(direction, np.ones(3))], gloss=bench.scene.gloss
        )
        run = render_naively(lit, mask, PLAIN_SAMPLES, depth)
        equal_noise += _seconds_for([run], run.variance / ours.directional)
        equal_paths += _seconds_for([run], sampling.spp)
    noise = measure_noise(captures).transport
    return {
        "noise.transport.plain": (noise * float(np.sqrt(np.mean(needed_transport) / paths)), "1"),
        "seconds.capture": (seconds, "s"),
        "seconds.exchange_mesh": (exchange, "s"),
        "seconds.load_scene": (load, "s"),
        "seconds.plain.same_noise": (equal_noise, "s"),
        "seconds.plain.same_paths": (equal_paths, "s"),
        "ratio.plain": (equal_noise / (seconds + exchange), "1"),
        "ratio.plain_same_paths": (equal_paths / (seconds + exchange), "1"),
    }


def _loaded(bench: Bench) -> SurfaceScene:
    return SurfaceScene(bench.face.mesh, bench.scene.camera, gloss=bench.scene.gloss)


def _mirror(bench: Bench) -> SurfaceScene:
    """The same surface with a black body: nothing but gloss is left."""
    black = replace(bench.face.mesh, albedo=np.zeros_like(bench.face.mesh.albedo))
    return SurfaceScene(black, bench.scene.camera, gloss=True)


def _plain(scene: SurfaceScene, light: Array, mask: Array, depth: int) -> NaiveRender:
    scene.set_environment(np.repeat(light[..., None], 3, axis=-1))
    return render_naively(scene, mask, PLAIN_SAMPLES, depth)


def _seconds_for(runs: list[NaiveRender], samples: float) -> float:
    """Time for a number of samples in all, spread over the runs, by the time of one sample alone.

    What a render costs beside its samples is not counted: that favours the plain way.
    """
    return sum(run.seconds / run.samples for run in runs) * samples / len(runs)


def _against_rays(bench: Bench) -> dict[str, tuple[float, str]]:
    """Rays a second of a whole capture over those of ``ray_test`` alone, in turns."""
    sampling = bench.spec.sampling
    rates, limits = [], []
    for _ in range(3):
        captures, seconds = bench.captures(sampling.spp)
        rates.append(captures[0].rays / seconds)
        limits.append(bare_ray_tests(bench.scene, 32, repeats=3))
    times = kernel_times(lambda: render_aovs(bench.scene, sampling.spp, 0, bench.options(), bench.directions))
    largest = max(times, key=lambda kernel: kernel.operations)
    _, whole = _timed(lambda: render_aovs(bench.scene, sampling.spp, 0, bench.options(), bench.directions))
    rate, limit = float(np.median(rates)), float(np.median(limits))
    return {
        "rays_per_capture": (captures[0].rays, "rays"),
        "rays_per_s": (rate, "rays/s"),
        "rays_per_s.ray_test": (limit, "rays/s"),
        "share.ray_rate": (rate / limit, "1"),
        "seconds.rays_at_the_limit": (captures[0].rays / limit, "s"),
        "seconds.kernel.paths": (largest.seconds, "s"),
        "seconds.kernel.coverage": (sum(k.seconds for k in times) - largest.seconds, "s"),
        "seconds.outside_kernels": (max(whole - sum(k.seconds for k in times), 0.0), "s"),
        "kernel.operations": (largest.operations, "operations"),
        "kernels_compiled": (sum(kernel.compiled for kernel in times), "kernels"),
    }


def _timed(work: Callable[[], T]) -> tuple[T, float]:
    begin = time.perf_counter()
    result = work()
    return result, time.perf_counter() - begin


#: Names of the samplers on the plot.
_SAMPLERS = {"sobol": "Sobol", "r4": "R4", "stratified": "stratified", "independent": "random"}


def write_bench(out: Path | str, records: Sequence[Record]) -> None:
    """Write ``records.json``, ``noise.png`` and ``index.html`` into a folder."""
    folder = output_dir(out)
    value = {record.what.removeprefix("synth."): record.value for record in records}
    plot = noise_plot(_lines(value), label="relative noise")
    write_records(folder / "records.json", records)
    with atomic_path(folder / "noise.png") as partial:
        partial.write_bytes(plot)
    lead = (
        f"{value['bundles_per_s']:.2f} complete faces a second; their light transport "
        f"{value['ratio.plain']:.0f} times as fast as one render for each light at the same noise."
    )
    caption = (
        "Noise of the transport against the time of one face's whole transport, for several samplers and "
        "numbers of camera rays a pixel. Down and to the left is better. Noise is relative to the image that "
        "a white sky gives. The point that stands alone: one render for each light, with as many paths as "
        "the scene asks for."
    )
    numbers = [
        (f"{value['bundles_per_s']:.2f} /s", "complete bundles"),
        (f"{value['ratio.plain']:.0f} x", "faster than one render a light, at the same noise"),
        (f"{value['ratio.plain_same_paths']:.0f} x", "the same, at the same number of paths"),
        (f"{100 * value['share.ray_rate']:.0f} %", "of the rate of a bare loop of ray tests"),
    ]
    sections = [
        Section("Speed", [KeyNumbers(numbers), _bundle_table(value), _capture_table(value)]),
        Section("Noise against time", [Figure(plot, caption)]),
    ]
    footer = ", ".join(f"{name} {version}" for name, version in records[0].versions.items())
    write_page(folder / "index.html", "How fast faces are rendered", lead, sections, footer=footer)


def _lines(value: Mapping[str, float]) -> dict[str, list[tuple[float, float, str]]]:
    """Seconds, noise and camera rays a pixel of every sampler, and of the plain way."""
    lines = {}
    for sampler, name in _SAMPLERS.items():
        counts = [key.rsplit(".", 1)[1] for key in value if key.startswith(f"noise.transport.{sampler}.")]
        keys = [f"{sampler}.{count}" for count in counts]
        lines[name] = [
            (
                value[f"seconds.capture.{key}"],
                value[f"noise.transport.{key}"],
                count if sampler == "sobol" else "",
            )
            for key, count in zip(keys, counts, strict=True)
        ]
    plain = (value["seconds.plain.same_paths"], value["noise.transport.plain"], "")
    return lines | {"one render for each light": [plain]}


def _bundle_table(value: Mapping[str, float]) -> Table:
    parts = {
        "sample the face": value["seconds.sample_face"],
        "put its mesh into the scene": value["seconds.exchange_mesh"],
        "maps and transport": value["seconds.capture"],
        "write the file": value["seconds.write_file"],
    }
    whole = value["seconds.bundle"]
    parts["path-traced reference and the rest"] = whole - sum(parts.values())
    return _times("part of a bundle", parts | {"whole": whole}, "Where the time of one face goes.")


def _capture_table(value: Mapping[str, float]) -> Table:
    rays, kernel = value["seconds.rays_at_the_limit"], value["seconds.kernel.paths"]
    parts = {
        "its rays, as fast as bare ray tests": rays,
        "the rest of that kernel: points, BSDF, sums": kernel - rays,
        "kernel that looks where the face is": value["seconds.kernel.coverage"],
        "outside of kernels": value["seconds.outside_kernels"],
    }
    caption = "Where the time of the transport goes, by the history of kernels."
    return _times("part of the transport", parts | {"whole": sum(parts.values())}, caption)


def _times(header: str, parts: Mapping[str, float], caption: str) -> Table:
    rows = [
        [name, f"{1e3 * seconds:.0f}", f"{100 * seconds / parts['whole']:.0f}"]
        for name, seconds in parts.items()
    ]
    return Table([header, "ms", "%"], rows, caption)
