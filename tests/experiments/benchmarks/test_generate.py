"""Benches: noise that is known, errors of known size, and runs that go on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfsnet_dr.cli.bench import BenchRelight, BenchSynth
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.experiments.benchmarks import relight
from sfsnet_dr.experiments.benchmarks.generate import write_bench
from sfsnet_dr.experiments.benchmarks.naive_rendering import measure_noise
from sfsnet_dr.experiments.benchmarks.relight import PARTS, FaceErrors, bench_relight, to_records
from sfsnet_dr.render.aovs import TransportMaps
from sfsnet_dr.render.transport_shading import relight_responses
from sfsnet_dr.report.record import Record
from sfsnet_dr.scene.spec import CameraSpec, HeadSpec, SamplingSpec, SceneSpec

TINY = SceneSpec(
    "tiny",
    "anny",
    camera=CameraSpec(size=24),
    head=HeadSpec(subdivision=0),
    sampling=SamplingSpec(spp=16, reference_spp=64),
)


def noisy_capture(seed: int, noise: float) -> TransportMaps:
    """White transport of 0.5 with noise, under a mask that leaves out what is wrong."""
    rng = np.random.default_rng(seed)
    mask = np.ones((32, 32), np.float32)
    mask[0] = 0

    def images(*shape: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        values = 0.5 + noise * rng.standard_normal((*shape[:1], 32, 32, *shape[1:]))
        values[:, 0] = 100 * rng.standard_normal(values[:, 0].shape)
        return values.astype(np.float32)

    zeros = np.zeros((32, 32, 3), np.float32)
    labels = np.zeros((32, 32), np.uint8)
    return TransportMaps(zeros, zeros, mask, mask, labels, images(25, 3), images(9), images(8, 3), 1)


def test_noise_is_found_again() -> None:
    found = measure_noise([noisy_capture(seed, 0.01) for seed in range(4)])
    # 25 x 31 x 32 x 3 values with 3 degrees of freedom each: 0.2 %; the fewest, of gloss, 0.6 %
    assert found.transport == pytest.approx(0.02, rel=0.01)
    assert found.gloss == pytest.approx(0.02, rel=0.03)
    assert found.directional == pytest.approx(0.02, rel=0.02)


def test_errors_become_roots_of_means_over_faces_and_lights() -> None:
    table = np.zeros((3, 2, len(PARTS)))
    table[:, 0, PARTS.index("total")] = [0.01, 0.03, 0.05]
    table[:, 1, PARTS.index("total")] = -0.01
    found = {r.what: r for r in to_records(table, ["studio", "ambient"], "bench", 0)}
    assert found["relight.studio.rel_rmse"].value == pytest.approx(np.sqrt(0.03))
    assert found["relight.ambient.rel_rmse"].value == 0.0  # an estimate below 0
    assert found["relight.rel_rmse"].value == pytest.approx(0.1)
    low, high = found["relight.rel_rmse"].interval or (1.0, 0.0)
    assert 0.0 <= low < 0.1 < high <= np.sqrt(0.02) + 1e-12
    assert found["relight.cause.truncation"].value == 0.0


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Seeds of the faces that are measured, by a stand-in that costs nothing."""
    seeds: list[int] = []

    class StandIn:
        def __init__(self, spec: SceneSpec, kinds: list[str]) -> None:
            self.lights = len(kinds)

        def measure(self, seed: int) -> FaceErrors:
            seeds.append(seed)
            image = np.full((self.lights, 24, 24, 3), 0.5, np.float32)
            squared = np.full((self.lights, len(PARTS)), 1e-4 * (seed + 1))
            return FaceErrors(squared, image, image, np.ones((24, 24), np.float32))

    monkeypatch.setattr(relight, "RelightBenchmark", StandIn)
    return seeds


def test_a_run_goes_on_where_it_was(tmp_path: Path, counted: list[int]) -> None:
    bench_relight(TINY, tmp_path, faces=2)
    records = bench_relight(TINY, tmp_path, faces=3)
    assert counted == [0, 1, 2]
    assert records[0].value == pytest.approx(np.sqrt(2e-4))
    assert {path.name for path in tmp_path.iterdir()} >= {"records.json", "index.html", "face-000002.npz"}
    assert "1.41 %" in (tmp_path / "index.html").read_text()


def test_what_cannot_go_on_is_refused(tmp_path: Path, counted: list[int]) -> None:
    bench_relight(TINY, tmp_path, faces=1)
    other = replace(TINY, sampling=SamplingSpec(spp=32))
    with pytest.raises(InputError, match=r"face-000000\.npz: measured with another scene"):
        bench_relight(other, tmp_path, faces=1)
    (tmp_path / "face-000000.npz").write_bytes(b"PK half a file")
    with pytest.raises(InputError, match=r"face-000000\.npz: damaged"):
        bench_relight(TINY, tmp_path, faces=1)
    with pytest.raises(InputError, match="shape 'sphere' found"):
        bench_relight(SceneSpec("ball", "sphere"), tmp_path / "ball")
    with pytest.raises(InputError, match="0 faces"):
        bench_relight(TINY, tmp_path / "none", faces=0)
    with pytest.raises(InputError, match="2 are needed"):
        BenchRelight(tmp_path / "few", paths=1).run()
    with pytest.raises(InputError, match="at least 1"):
        BenchSynth(tmp_path / "none", faces=0).run()
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
def test_a_wrong_relit_image_is_measured_and_its_causes_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relight, "relight_responses", lambda *parts: 1.2 * relight_responses(*parts))
    errors = relight.RelightBenchmark(TINY, ["ambient"]).measure(3)
    found = dict(zip(PARTS, np.sqrt(np.maximum(errors.squared[0], 0)), strict=True))
    assert found["total"] == pytest.approx(0.2, abs=0.03)  # noise of the estimate at 64 paths
    assert found["rest"] == pytest.approx(0.2, abs=0.03)
    assert found["truncation"] < 0.01
    assert found["bounces"] < 0.02
    assert found["gloss"] < 0.02


def test_the_page_tells_what_was_measured(tmp_path: Path) -> None:
    numbers = dict.fromkeys(
        [
            "bundles_per_s", "ratio.plain", "ratio.plain_same_paths", "share.ray_rate", "seconds.bundle",
            "seconds.sample_face", "seconds.exchange_mesh", "seconds.capture", "seconds.write_file",
            "seconds.rays_at_the_limit", "seconds.kernel.paths", "seconds.kernel.coverage",
            "seconds.outside_kernels", "seconds.plain.same_paths", "noise.transport.plain",
        ],
        0.25,
    ) | {"ratio.plain": 40.4}  # fmt: skip
    for count in (4, 16):
        for sampler in ("sobol", "r4", "stratified", "independent"):
            numbers |= {f"noise.transport.{sampler}.{count}": 0.1, f"seconds.capture.{sampler}.{count}": 0.02}
    write_bench(tmp_path, [Record(f"synth.{name}", value, "1") for name, value in numbers.items()])
    assert "40 times as fast" in (tmp_path / "index.html").read_text()
    assert (tmp_path / "noise.png").read_bytes().startswith(b"\x89PNG")
