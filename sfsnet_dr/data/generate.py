"""Renders a dataset: one bundle a seed, in any number of processes, resumable at any moment."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core import provenance
from sfsnet_dr.core.config import as_dict, fingerprint
from sfsnet_dr.core.errors import InputError, RunError
from sfsnet_dr.core.files import atomic_path, output_dir
from sfsnet_dr.data.bundle import Bundle, BundleMeta, read_bundle, write_bundle
from sfsnet_dr.data.manifest import NAME, Entry, Manifest
from sfsnet_dr.data.parallel import choose_workers
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import MAP_ORDER, Light
from sfsnet_dr.scene.lights.sampling import sample_direction, sample_scene_light
from sfsnet_dr.scene.lights.vmf_lobes import sample_lights
from sfsnet_dr.scene.spec import FACE_SHAPES, SceneSpec
from sfsnet_dr.sh.coefficients import Radiance

if TYPE_CHECKING:
    from sfsnet_dr.scene.scene_cache import SceneCache

# Random streams of a seed's reference light and of its directional lights, apart from those of its face.
_LIGHT_STREAM, _DIRECTIONS_STREAM = 16, 17
_PARTIAL = ".partial-"

Array = npt.NDArray[np.float64]

_scenes: SceneCache | None = None  # one per process, made by the first face: it loads Mitsuba


def synthesize(
    out: Path | str,
    spec: SceneSpec,
    count: int,
    *,
    seed: int = 0,
    workers: int = 1,
    resume: bool = False,
    ray: str | None = None,
    on_face: Callable[[int], None] | None = None,
) -> Manifest:
    """Render faces ``seed .. seed + count - 1`` into a folder.

    The bytes of a bundle depend on the spec and its seed alone, not on the number of workers, on where they
    run or on interruptions. Only this process writes into the folder's list, in the order of the seeds; a
    bundle that is not listed yet when all is cut off is rendered again.

    Args:
        out: folder; it gets ``face-NNNNNN.exr`` and ``manifest.jsonl``.
        spec: a scene whose shape is a face model.
        count: number of faces, at least 1.
        seed: first seed, at least 0.
        workers: faces rendered side by side; a single one is rendered in this process.
        resume: continue a folder that already holds bundles of this spec.
        ray: None, ``"local"`` or the address of a Ray cluster; see ``data.workers.choose``.
        on_face: called with a seed when its bundle is in place.

    Returns:
        The list of the folder's bundles.

    Raises:
        InputError: for a folder that holds another dataset, or this one without ``resume``, or that another
            run is writing; for a face model that cannot be read, or a full disk.
        RunError: if a worker dies.

    Example:
        >>> import tempfile
        >>> import sfsnet_dr as sf
        >>> from sfsnet_dr.scene.spec import CameraSpec, HeadSpec, SamplingSpec, SceneSpec
        >>> head, sampling = HeadSpec(subdivision=0), SamplingSpec(4, 1, 0, 2, 4)
        >>> scene = SceneSpec("tiny", "anny", camera=CameraSpec(size=16), head=head, sampling=sampling)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     manifest = sf.synthesize(folder, scene, 1)
        ...     faces = sf.load_faces(folder)
        >>> [entry.file for entry in manifest.entries], tuple(faces.normal.shape)
        (['face-000000.exr'], (1, 3, 16, 16))
    """
    if count < 1 or seed < 0 or workers < 1:
        raise InputError(
            f"synth: count {count}, seed {seed}, workers {workers} found; at least 1, 0 and 1 are needed"
        )
    if spec.shape not in FACE_SHAPES:
        raise InputError(
            f"{spec.name}: shape {spec.shape!r} found, a dataset needs one of {', '.join(FACE_SHAPES)}"
        )
    crew, dataset = choose_workers(workers, count, ray), dataset_identity(spec)
    folder, made = Path(out), not Path(out).exists()
    output_dir(folder)
    try:
        with _only_writer(folder), _full_disk_explained(folder):
            manifest = Manifest(folder, fingerprint(dataset))
            _check_folder(manifest, range(seed, seed + count), resume)
            finished = manifest.finished_seeds()
            todo = [k for k in range(seed, seed + count) if k not in finished]
            scratch = folder if ray is None else None  # processes of Ray may run on another machine
            _list_in_order(
                manifest, dataset, todo, crew.run(partial(render_file, spec, scratch), todo), on_face
            )
    finally:
        if made and not any(folder.iterdir()):
            folder.rmdir()
    return manifest


def dataset_identity(spec: SceneSpec) -> SceneSpec:
    """The spec that a dataset is known by: a hash of the face model in place of the path to it.

    Raises:
        InputError: for a face model that cannot be read.
    """
    if spec.model_path is None and spec.shape == "anny":
        return spec
    from sfsnet_dr.scene.faces.registry import load_face_model

    return replace(spec, model_path=load_face_model(spec).digest)


def face_file(seed: int) -> str:
    """Name of a seed's bundle."""
    return f"face-{seed:06d}.exr"


def render_file(spec: SceneSpec, scratch: Path | None, seed: int) -> bytes:
    """The bytes of one bundle's file.

    Args:
        spec: what to render.
        scratch: folder for a temporary copy; None takes the system's.
        seed: of the face.
    """
    bundle = render_bundle(spec, seed)
    with tempfile.TemporaryDirectory(prefix=_PARTIAL, dir=scratch) as folder:
        path = Path(folder) / face_file(seed)
        try:
            write_bundle(path, bundle)
        except RunError as error:
            raise InputError(
                f"{scratch or path.parent}: a bundle cannot be written, is the disk full? Free some space "
                f"and go on with --resume ({error})"
            ) from error
        return path.read_bytes()


def render_bundle(spec: SceneSpec, seed: int) -> Bundle:
    """Maps, transport and a path-traced reference of one seeded face."""
    from sfsnet_dr.render.aovs import TransportOptions, render_aovs
    from sfsnet_dr.render.path_tracer import path_trace
    from sfsnet_dr.scene.faces.face import sample_face
    from sfsnet_dr.scene.scene_cache import SceneCache

    dataset, face, sampling = dataset_identity(spec), sample_face(seed, spec), spec.sampling
    camera = face.pose.camera(spec.camera)
    global _scenes
    _scenes = _scenes or SceneCache()
    directions = _sample_directions(seed, sampling.directional_lights)
    options = TransportOptions(MAP_ORDER, sampling.max_bounces, sampling.paths_per_hit)
    scene = _scenes.show(face.mesh, camera, gloss=spec.has_gloss)
    maps = render_aovs(scene, sampling.spp, seed, options, directions)
    light, coefficients = _reference_light(spec, seed, directions)
    scene = _scenes.show(face.mesh, camera, light, gloss=spec.has_gloss)
    reference = path_trace(scene, sampling.reference_spp, seed, sampling.max_depth)
    extra: dict[str, Any] = {
        "spec": as_dict(dataset),
        "pose": as_dict(face.pose),
        "landmarks": {name: point.tolist() for name, point in face.landmarks.items()},
    }
    if spec.light is not None:
        extra["light"] = {
            "kind": light.name,
            "directional": [[toward.tolist(), power.tolist()] for toward, power in light.directional],
        }
    if face.appearance is not None:
        extra["ita"] = round(float(face.appearance.ita), 3)
    return Bundle(
        normal=maps.normal,
        albedo=maps.albedo,
        mask=maps.mask,
        coverage=maps.coverage,
        regions=maps.regions,
        reference=reference.mean.astype(np.float32),
        variance=reference.variance.astype(np.float32),
        transport=maps.transport,
        gloss=maps.gloss,
        directional=maps.directional,
        directions=directions,
        meta=BundleMeta(seed, spec.shape, fingerprint(dataset), coefficients, extra),
    )


def _reference_light(spec: SceneSpec, seed: int, directions: Array) -> tuple[Light, Radiance]:
    """Return the light of a seed's reference and its coefficients.

    It is drawn as the scene's ``[light]`` table says, else soft lobes, whose coefficients are exact.
    """
    rng = np.random.default_rng((seed, _LIGHT_STREAM))
    if spec.light is None:
        lobes = sample_lights(rng, 1)[0]
        return Light("lobes", lobes.equirect(*MAP_SIZE)), lobes.coefficients(MAP_ORDER)
    light = sample_scene_light(rng, spec.light, directions if len(directions) else None)
    return light, light.coefficients(MAP_ORDER)


def _sample_directions(seed: int, count: int) -> Array:
    """(count, 3) directions of a seed's directional lights, evenly spread in solid angle."""
    rng = np.random.default_rng((seed, _DIRECTIONS_STREAM))
    return np.array([sample_direction(rng) for _ in range(count)]).reshape(count, 3)


def _list_in_order(
    manifest: Manifest,
    dataset: SceneSpec,
    todo: Sequence[int],
    rendered: Iterator[tuple[int, bytes]],
    on_face: Callable[[int], None] | None,
) -> None:
    """Put bundles in place as they come, and list them in the order of ``todo``."""
    listed = {entry.file: entry.sha256 for entry in manifest.entries}
    versions = provenance.versions()
    ready: dict[int, Entry] = {}
    order = deque(todo)
    for seed, data in rendered:
        digest, name = provenance.sha256(data), face_file(seed)
        if listed.get(name, digest) != digest:
            raise RunError(
                f"{manifest.folder / name}: rendered again, but its bytes are not those that {NAME} lists; "
                "the software has changed since: choose another folder"
            )
        _store(manifest.folder / name, data)
        ready[seed] = Entry(name, seed, dataset.shape, fingerprint(dataset), digest, versions)
        while order and order[0] in ready:
            entry = ready.pop(order.popleft())
            if entry.file not in listed:
                manifest.append(entry)
        if on_face is not None:
            on_face(seed)


def _store(path: Path, data: bytes) -> None:
    """Write a file that is whole, and on the disk, before it is listed."""
    with atomic_path(path) as partial_path, partial_path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _check_folder(manifest: Manifest, seeds: range, resume: bool) -> None:
    """Refuse what must not be overwritten, and sweep up after a run that was killed."""
    folder = manifest.folder
    if manifest.entries and not resume:
        raise InputError(
            f"{folder}: already holds {len(manifest.entries)} bundles; add --resume or choose another folder"
        )
    listed = {entry.file for entry in manifest.entries}
    for name in map(face_file, seeds):
        if name not in listed and (folder / name).exists():
            _check_unlisted(folder / name, manifest.spec_hash, resume)
    if resume:
        for leftover in folder.glob(f"{_PARTIAL}*"):
            shutil.rmtree(leftover) if leftover.is_dir() else leftover.unlink()


def _check_unlisted(path: Path, spec_hash: str | None, resume: bool) -> None:
    if not resume:
        raise InputError(f"{path}: is there, but not listed in {NAME}; add --resume or choose another folder")
    try:
        found = read_bundle(path).meta.spec_hash
    except InputError:
        return  # no bundle that could be lost
    if found != spec_hash:
        raise InputError(
            f"{path}: bundle of specification {found} found, {spec_hash} expected; choose another folder"
        )


@contextmanager
def _only_writer(folder: Path) -> Iterator[None]:
    """Hold the folder's lock, which ends with this process, whatever ends it."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError as error:
        raise InputError(
            f"{folder}: another run is writing here; wait for it or choose another folder"
        ) from error
    finally:
        os.close(handle)


@contextmanager
def _full_disk_explained(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise
        raise InputError(
            f"{folder}: cannot be written to ({error.strerror}); free some space and go on with --resume"
        ) from error
