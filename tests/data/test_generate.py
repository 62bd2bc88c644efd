"""Rendering datasets: bytes that depend on spec and seed alone, and nothing lost when it is cut off."""

from __future__ import annotations

import errno
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from helpers.disks import files_up_to

from sfsnet_dr.core.config import fingerprint
from sfsnet_dr.core.errors import InputError, RunError
from sfsnet_dr.data import generate
from sfsnet_dr.data.bundle import Bundle, read_bundle
from sfsnet_dr.data.generate import synthesize
from sfsnet_dr.data.manifest import Manifest
from sfsnet_dr.data.relight import relight_bundle
from sfsnet_dr.render.transport_shading import relight_transport
from sfsnet_dr.scene.jit import dr
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.lights.sampling import sample_scene_light
from sfsnet_dr.scene.lights.spec import LightSpec
from sfsnet_dr.scene.spec import CameraSpec, HeadSpec, SamplingSpec, SceneSpec, load_scene

ROOT = Path(__file__).parents[2]
TINY = SceneSpec(
    "tiny",
    "anny",
    camera=CameraSpec(size=24),
    head=HeadSpec(subdivision=0),
    sampling=SamplingSpec(spp=32, reference_spp=16),
)

#: A process that fills a folder quickly, with copies of one bundle that differ by seed.
QUICK = """
import sys
from dataclasses import replace
from pathlib import Path
from sfsnet_dr.data import generate
from sfsnet_dr.data.bundle import read_bundle
from data.test_generate import TINY, StandIn
generate.render_bundle = StandIn(read_bundle(sys.argv[1]))
generate.synthesize(Path(sys.argv[2]), TINY, int(sys.argv[3]), resume=True)
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    synthesize(folder, TINY, 3, seed=5)
    return folder


class StandIn:
    """In place of ``render_bundle`` where only the files matter."""

    def __init__(self, bundle: Bundle) -> None:
        self.bundle = bundle

    def __call__(self, spec: SceneSpec, seed: int) -> Bundle:
        noise = np.random.default_rng(seed).random(self.bundle.albedo.shape, dtype=np.float32)
        meta = replace(self.bundle.meta, seed=seed, spec_hash=fingerprint(spec))
        return replace(self.bundle, albedo=noise, meta=meta)


@pytest.fixture
def quick(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(generate, "render_bundle", StandIn(read_bundle(whole / "face-000005.exr")))


def content(folder: Path) -> dict[str, bytes]:
    """Every file, hidden ones included."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_it_writes_a_bundle_a_seed_and_lists_them(whole: Path) -> None:
    names = ["face-000005.exr", "face-000006.exr", "face-000007.exr", "manifest.jsonl"]
    assert sorted(content(whole)) == names
    assert [entry.file for entry in Manifest(whole).entries] == names[:3]


def test_a_bundle_holds_one_face_and_its_light(whole: Path) -> None:
    bundle = read_bundle(whole / "face-000006.exr")
    assert bundle.meta.seed == 6
    assert -90 < bundle.meta.extra["ita"] < 90
    assert 0.1 < bundle.mask.mean() < 0.8
    lengths = np.linalg.norm(bundle.normal, axis=-1)[bundle.coverage > 0]
    np.testing.assert_allclose(lengths, 1.0, atol=2e-3)  # half floats
    image = relight_transport(bundle.transport, bundle.meta.light)
    face = bundle.mask > 0
    error = np.sqrt(np.mean((image - bundle.reference)[face] ** 2) / np.mean(bundle.reference[face] ** 2))
    assert error < 0.25  # 16 paths of noise, bounces and order 2; another light's picture is off by more
    other = relight_transport(bundle.transport, read_bundle(whole / "face-000005.exr").meta.light)
    wrong = np.sqrt(np.mean((other - bundle.reference)[face] ** 2) / np.mean(bundle.reference[face] ** 2))
    assert wrong > error


LAMPS_ONLY = LightSpec(hdr=0, sun_sky=0, studio=0, directional=1, ambient=0)


def test_the_reference_is_lit_as_the_scene_says() -> None:
    lit = replace(TINY, light=LAMPS_ONLY, sampling=replace(TINY.sampling, reference_spp=256))
    bundle, lobes = generate.render_bundle(lit, 5), generate.render_bundle(TINY, 5)
    assert bundle.meta.spec_hash != lobes.meta.spec_hash
    assert bundle.meta.extra["light"]["kind"] == "directional"
    assert "light" not in lobes.meta.extra
    light = sample_scene_light(np.random.default_rng((5, 16)), LAMPS_ONLY, bundle.directions)
    for found, drawn in zip(bundle.meta.extra["light"]["directional"], light.directional, strict=True):
        np.testing.assert_allclose(found, drawn)
    face = bundle.mask > 0
    # Relit by its transport and its responses to lamps, the face looks like the path-traced reference.
    errors = {
        name: float(
            np.sqrt(np.mean((relight_bundle(bundle, by) - bundle.reference)[face] ** 2))
            / np.sqrt(np.mean(bundle.reference[face] ** 2))
        )
        for name, by in (("its light", light), ("another", Light("white", np.ones((64, 128, 3)))))
    }
    assert errors["its light"] < 0.2 < errors["another"]  # noise of 16 and 256 paths; 0.12 and 0.6 measured


def test_a_second_face_compiles_nothing(whole: Path) -> None:
    """Of a whole bundle: shape, transport and reference. Kernels loaded from the disk's cache count, too."""
    generate.render_bundle(TINY, 5)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for seed in (6, 7):
            generate.render_bundle(TINY, seed)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert len(kernels) >= 2 * 3  # where the face is, paths, reference
    new = [kernel["hash"] for kernel in kernels if kernel["cache_disk"] or not kernel["cache_hit"]]
    assert new == []


def test_a_run_cut_off_goes_on_to_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    synthesize(tmp_path, TINY, 2, seed=5)
    manifest = tmp_path / "manifest.jsonl"
    lines = manifest.read_bytes().splitlines(keepends=True)
    manifest.write_bytes(lines[0] + lines[1][:40])  # as if killed while writing the second line
    (tmp_path / "face-000006.exr").write_bytes(b"half")
    (tmp_path / ".partial-a1b2.exr").write_bytes(b"half")
    (tmp_path / ".partial-c3d4").mkdir()
    (tmp_path / ".partial-c3d4" / "face-000007.exr").write_bytes(b"half")
    seeds: list[int] = []
    synthesize(tmp_path, TINY, 3, seed=5, resume=True, on_face=seeds.append)
    assert seeds == [6, 7]
    assert content(tmp_path) == content(whole)


def test_killed_at_random_moments_it_ends_with_the_same_bytes(
    whole: Path, tmp_path: Path, quick: None
) -> None:
    count, broken, unbroken = 60, tmp_path / "broken", tmp_path / "unbroken"
    synthesize(unbroken, TINY, count)
    moments = random.Random(0)
    places = []
    for _ in range(3):
        process = start([sys.executable, "-c", QUICK, whole / "face-000005.exr", broken, count])
        wait_for_more_faces(broken, process)
        time.sleep(moments.uniform(0.0, 0.15))
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        places.append(len(Manifest(broken).entries))
        for entry in Manifest(broken).entries:
            assert (broken / entry.file).read_bytes() == (unbroken / entry.file).read_bytes()
    assert 0 < places[0] < count  # killed while at work
    synthesize(broken, TINY, count, resume=True)
    assert content(broken) == content(unbroken)


@pytest.mark.slow
def test_killed_with_its_workers_it_ends_with_the_same_bytes(tmp_path: Path) -> None:
    count, broken, unbroken = 40, tmp_path / "broken", tmp_path / "unbroken"
    scene = tmp_path / "scene.toml"
    scene.write_text(
        'name = "tiny"\nshape = "anny"\n[camera]\nsize = 24\n[head]\nsubdivision = 0\n'
        "[sampling]\ntransport = 32\nreference = 16\n"
    )
    assert load_scene(scene) == TINY
    synthesize(unbroken, TINY, count)
    code = "import sys; from sfsnet_dr.cli.main import main; sys.exit(main(sys.argv[1:]))"
    arguments = ["synth", "--scene", scene, "--out", broken, "--count", count, "--workers", 2, "--resume"]
    moments = random.Random(1)
    at_work = 0
    for _ in range(3):
        process = start([sys.executable, "-c", code, *arguments])
        wait_for_more_faces(broken, process)
        time.sleep(moments.uniform(0.0, 0.5))
        at_work += process.poll() is None
        with suppress(ProcessLookupError):  # a quick machine may have ended it first
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert at_work > 0
    last = start([sys.executable, "-c", code, *arguments])
    assert last.wait() == 0
    assert content(broken) == content(unbroken)


def start(command: list[object]) -> subprocess.Popen[bytes]:
    """A process group of its own that finds this package and these tests."""
    paths = [str(Path(__file__).parents[1]), *filter(None, sys.path), str(ROOT)]
    return subprocess.Popen(
        [str(word) for word in command],
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        start_new_session=True,
    )


def wait_for_more_faces(folder: Path, process: subprocess.Popen[bytes]) -> None:
    """Until one more face is in place, or the process has ended."""
    before = len(list(folder.glob("face-*.exr")))
    while process.poll() is None and len(list(folder.glob("face-*.exr"))) == before:
        time.sleep(0.005)


@pytest.mark.slow
def test_two_workers_give_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    synthesize(tmp_path, TINY, 3, seed=5, workers=2)
    assert content(tmp_path) == content(whole)


@pytest.mark.slow
@pytest.mark.skipif(find_spec("ray") is None, reason="the extra `distributed` is not installed")
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_ray_gives_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    synthesize(tmp_path, TINY, 3, seed=5, workers=2, ray="local")
    assert content(tmp_path) == content(whole)


def test_faces_are_listed_by_seed_in_whatever_order_they_come(
    whole: Path, tmp_path: Path, quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Backwards:
        def run(self, work: object, seeds: list[int]) -> Iterator[tuple[int, bytes]]:
            assert callable(work)
            for seed in reversed(seeds):
                yield seed, work(seed)

    synthesize(tmp_path / "plain", TINY, 4)
    monkeypatch.setattr(generate, "choose_workers", lambda *arguments: Backwards())
    synthesize(tmp_path / "backwards", TINY, 4)
    assert content(tmp_path / "backwards") == content(tmp_path / "plain")


def test_a_listed_face_that_was_lost_is_made_again(tmp_path: Path, quick: None) -> None:
    synthesize(tmp_path, TINY, 3)
    before = content(tmp_path)
    (tmp_path / "face-000001.exr").unlink()
    synthesize(tmp_path, TINY, 3, resume=True)
    assert content(tmp_path) == before


def test_a_lost_face_that_comes_out_different_is_not_slipped_in(
    tmp_path: Path, quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    synthesize(tmp_path, TINY, 2)
    (tmp_path / "face-000001.exr").unlink()
    monkeypatch.setattr(generate, "render_file", lambda spec, scratch, seed: b"made by other software")
    with pytest.raises(RunError, match="its bytes are not those that"):
        synthesize(tmp_path, TINY, 2, resume=True)
    assert not (tmp_path / "face-000001.exr").exists()


def test_another_dataset_is_not_overwritten(whole: Path) -> None:
    before = content(whole)
    with pytest.raises(InputError, match="already holds 3 bundles; add --resume"):
        synthesize(whole, TINY, 3, seed=5)
    other = SceneSpec("other", "anny", camera=CameraSpec(size=16))
    with pytest.raises(InputError, match="choose another folder"):
        synthesize(whole, other, 1, resume=True)
    assert content(whole) == before


def test_a_face_that_no_list_knows_is_not_overwritten(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "face-000005.exr"
    path.write_bytes((whole / "face-000005.exr").read_bytes())
    with pytest.raises(InputError, match=r"face-000005\.exr: is there, but not listed"):
        synthesize(tmp_path, TINY, 1, seed=5)
    other = SceneSpec("other", "anny", camera=CameraSpec(size=16))
    with pytest.raises(InputError, match=r"face-000005\.exr: bundle of specification"):
        synthesize(tmp_path, other, 1, seed=5, resume=True)
    assert content(tmp_path) == {path.name: (whole / path.name).read_bytes()}


@pytest.mark.parametrize("missing", [1, 20_000])
def test_a_full_disk_is_told_and_leaves_nothing_half_written(
    whole: Path, tmp_path: Path, quick: None, missing: int
) -> None:
    synthesize(tmp_path / "probe", TINY, 1)
    size = (tmp_path / "probe" / "face-000000.exr").stat().st_size
    folder = tmp_path / "out"
    with files_up_to(size - missing), pytest.raises(InputError, match="is the disk full"):
        synthesize(folder, TINY, 1)
    assert not folder.exists() or content(folder) == {}
    synthesize(folder, TINY, 1, resume=True)
    assert content(folder) == content(tmp_path / "probe")


def test_a_disk_that_fills_up_later_is_told_too(
    tmp_path: Path, quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Manifest, "append", full)
    with pytest.raises(InputError, match=r"No space left on device.*free some space and go on with --resume"):
        synthesize(tmp_path, TINY, 1)
