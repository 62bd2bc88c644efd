"""Renders a dataset: one bundle a seed, in any number of processes, resumable at any moment."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sfsnet_dr.base import provenance, runtime
from sfsnet_dr.base.atomic import output_dir
from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.base.config import as_dict, fingerprint
from sfsnet_dr.base.conventions import LIGHT_ORDER
from sfsnet_dr.data.bundle import Bundle, BundleMeta, write_bundle
from sfsnet_dr.data.manifest import Entry, Manifest
from sfsnet_dr.scene.spec import SceneSpec
from sfsnet_dr.sh.priors import sample_lights

if TYPE_CHECKING:
    from sfsnet_dr.scene.mesh import Mesh
    from sfsnet_dr.scene.mitsuba_scene import SurfaceScene

#: Faces after which a worker process is replaced: thousands of renders in one process have been seen to hang.
FACES_PER_WORKER = 200

_LIGHT_STREAM = 16  # random stream of a seed's light, apart from those of its face

_scene: SurfaceScene | None = None  # one per process: another would compile and upload all anew


def synthesize(
    out: Path | str,
    spec: SceneSpec,
    count: int,
    *,
    seed: int = 0,
    workers: int = 1,
    resume: bool = False,
    on_face: Callable[[int], None] | None = None,
) -> Manifest:
    """Render faces ``seed .. seed + count - 1`` into a folder.

    The bytes of a bundle depend on the spec and its seed alone, not on the number of workers or on
    interruptions.

    Args:
        out: folder; it gets ``face-NNNNNN.exr`` and ``manifest.jsonl``.
        spec: a scene whose shape is ``"anny"``.
        count: number of faces, at least 1.
        seed: first seed, at least 0.
        workers: processes; 1 renders in this process.
        resume: continue a folder that already holds bundles of this spec.
        on_face: called with a seed when its bundle is in place.

    Raises:
        BadInput: for a folder that holds another dataset, or this one without ``resume``.
    """
    if count < 1 or seed < 0 or workers < 1:
        raise BadInput(
            f"synth: count {count}, seed {seed}, workers {workers} found; at least 1, 0 and 1 are needed"
        )
    if spec.shape != "anny":
        raise BadInput(f"{spec.name}: shape {spec.shape!r} found, a dataset of faces needs 'anny'")
    folder = output_dir(out)
    manifest = Manifest(folder, fingerprint(spec))
    if manifest.entries and not resume:
        raise BadInput(
            f"{folder}: already holds {len(manifest.entries)} bundles; add --resume or choose another folder"
        )
    done = manifest.finished_seeds()
    todo = [k for k in range(seed, seed + count) if k not in done]
    versions = provenance.versions()
    with _mapper(workers) as run:
        for face_seed, path in run(partial(render_face, spec, folder), todo):
            digest = provenance.sha256(path)
            manifest.append(Entry(path.name, face_seed, spec.shape, fingerprint(spec), digest, versions))
            if on_face is not None:
                on_face(face_seed)
    return manifest


def render_face(spec: SceneSpec, folder: Path, seed: int) -> tuple[int, Path]:
    """Render and write one bundle; returns its seed and file."""
    path = folder / f"face-{seed:06d}.exr"
    write_bundle(path, render_bundle(spec, seed))
    return seed, path


def render_bundle(spec: SceneSpec, seed: int) -> Bundle:
    """Maps, transport and a path-traced reference of one seeded face."""
    from sfsnet_dr.render.capture import capture
    from sfsnet_dr.render.reference import path_trace
    from sfsnet_dr.scene.face import sample_face
    from sfsnet_dr.scene.mitsuba_scene import ENVIRONMENT_SIZE

    face = sample_face(seed, spec)
    scene = _place_in_scene(spec, face.mesh)
    light = sample_lights(np.random.default_rng((seed, _LIGHT_STREAM)), 1)[0]
    scene.set_environment(light.equirect(*ENVIRONMENT_SIZE))
    maps = capture(scene, spec.sampling.transport, seed)
    reference = path_trace(scene, spec.sampling.reference, seed, spec.sampling.depth)
    extra = {
        "spec": as_dict(spec),
        "pose": as_dict(face.pose),
        "landmarks": {name: point.tolist() for name, point in face.landmarks.items()},
    }
    return Bundle(
        normal=maps.normal,
        albedo=maps.albedo,
        mask=maps.mask,
        coverage=maps.coverage,
        reference=reference.mean.astype(np.float32),
        variance=reference.variance.astype(np.float32),
        transport=maps.transport,
        meta=BundleMeta(seed, spec.shape, fingerprint(spec), light.coefficients(LIGHT_ORDER), extra),
    )


def _place_in_scene(spec: SceneSpec, mesh: Mesh) -> SurfaceScene:
    from sfsnet_dr.scene.mitsuba_scene import SurfaceScene

    global _scene
    if _scene is None or not _scene.fits(mesh, spec.camera):
        _scene = SurfaceScene(mesh, spec.camera)
    else:
        _scene.set_mesh(mesh)
    return _scene


_Runner = Callable[[Callable[[int], tuple[int, Path]], Iterable[int]], Iterator[tuple[int, Path]]]


@contextmanager
def _mapper(workers: int) -> Iterator[_Runner]:
    """An ordered map over seeds, in this process or in a pool of fresh ones."""
    if workers == 1:
        yield map
        return
    context = multiprocessing.get_context("spawn")
    threads = max(1, (multiprocessing.cpu_count() or 1) // workers)
    with context.Pool(workers, runtime.set_threads, (threads,), maxtasksperchild=FACES_PER_WORKER) as pool:
        yield pool.imap
