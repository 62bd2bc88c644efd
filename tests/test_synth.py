"""Rendering datasets: bytes that depend on spec and seed alone, and nothing lost when it is cut off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.data.bundle import read_bundle
from sfsnet_dr.data.relight import relight
from sfsnet_dr.data.synth import synthesize
from sfsnet_dr.scene.spec import CameraSpec, HeadSpec, SamplingSpec, SceneSpec

TINY = SceneSpec(
    "tiny",
    "anny",
    camera=CameraSpec(size=24),
    head=HeadSpec(subdivision=0),
    sampling=SamplingSpec(transport=32, reference=16),
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    synthesize(folder, TINY, 3, seed=5)
    return folder


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.exr"))}


def test_it_writes_a_bundle_a_seed_and_lists_them(whole: Path) -> None:
    assert sorted(content(whole)) == ["face-000005.exr", "face-000006.exr", "face-000007.exr"]
    assert len((whole / "manifest.jsonl").read_text().splitlines()) == 3


def test_a_bundle_holds_one_face_and_its_light(whole: Path) -> None:
    bundle = read_bundle(whole / "face-000006.exr")
    assert bundle.meta.seed == 6
    assert 0.1 < bundle.mask.mean() < 0.8
    lengths = np.linalg.norm(bundle.normal, axis=-1)[bundle.coverage > 0]
    np.testing.assert_allclose(lengths, 1.0, atol=2e-3)  # half floats
    image = relight(bundle.transport, bundle.meta.light)
    face = bundle.mask > 0
    error = np.sqrt(np.mean((image - bundle.reference)[face] ** 2) / np.mean(bundle.reference[face] ** 2))
    assert error < 0.25  # 16 paths of noise, bounces and order 2; another light's picture is off by more
    other = relight(bundle.transport, read_bundle(whole / "face-000005.exr").meta.light)
    wrong = np.sqrt(np.mean((other - bundle.reference)[face] ** 2) / np.mean(bundle.reference[face] ** 2))
    assert wrong > error


def test_a_run_cut_off_goes_on_to_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    synthesize(tmp_path, TINY, 2, seed=5)
    manifest = tmp_path / "manifest.jsonl"
    lines = manifest.read_bytes().splitlines(keepends=True)
    manifest.write_bytes(lines[0] + lines[1][:40])  # as if killed while writing the second line
    (tmp_path / "face-000006.exr").write_bytes(b"half")
    seeds: list[int] = []
    synthesize(tmp_path, TINY, 3, seed=5, resume=True, on_face=seeds.append)
    assert seeds == [6, 7]
    assert content(tmp_path) == content(whole)


@pytest.mark.slow
def test_two_workers_give_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    synthesize(tmp_path, TINY, 3, seed=5, workers=2)
    assert content(tmp_path) == content(whole)
    assert (tmp_path / "manifest.jsonl").read_bytes() == (whole / "manifest.jsonl").read_bytes()


def test_another_dataset_is_not_overwritten(whole: Path) -> None:
    before = content(whole)
    with pytest.raises(BadInput, match="already holds 3 bundles; add --resume"):
        synthesize(whole, TINY, 3, seed=5)
    other = SceneSpec("other", "anny", camera=CameraSpec(size=16))
    with pytest.raises(BadInput, match="choose another folder"):
        synthesize(whole, other, 1, resume=True)
    assert content(whole) == before


@pytest.mark.parametrize(
    ("spec", "count", "words"),
    [(TINY, 0, "count 0"), (SceneSpec("ball", "sphere"), 1, "shape 'sphere' found")],
)
def test_what_cannot_be_a_dataset_is_refused(tmp_path: Path, spec: SceneSpec, count: int, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        synthesize(tmp_path / "out", spec, count)
    assert not (tmp_path / "out").exists()
