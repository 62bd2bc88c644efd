"""The ladder on a sphere, where every rung's error is known, and what the command leaves behind."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pytest

from sfsnet_dr.base.checks import BadInput, WorkFailed
from sfsnet_dr.report.record import read_records
from sfsnet_dr.scene.spec import CameraSpec, SamplingSpec, SceneSpec
from sfsnet_dr.study.demo import run_demo
from sfsnet_dr.study.ladder import HARD_LIGHT, Ladder, climb
from sfsnet_dr.study.validate import cheapest, ladder_records, pooled, to_csv, validate

BALL = """
name = "ball"
shape = "sphere"
albedo = [0.5, 0.5, 0.5]
[camera]
size = 32
[sampling]
transport = 128
reference = 64
depth = 2
"""


@pytest.fixture(scope="module")
def ladder() -> Ladder:
    sampling = SamplingSpec(transport=128, reference=64, depth=2)
    return climb(
        SceneSpec("ball", "sphere", albedo=(0.5, 0.5, 0.5), camera=CameraSpec(size=32), sampling=sampling)
    )


def expected_error(order: int) -> float:
    """Relative RMS error of an order under the hard light, by quadrature over the visible hemisphere."""
    from numpy.polynomial import legendre

    direction = HARD_LIGHT[0] / np.linalg.norm(HARD_LIGHT[0])
    x, y = np.meshgrid(np.linspace(-1, 1, 801), np.linspace(-1, 1, 801))
    inside = x**2 + y**2 < 0.97
    normal = np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1)[inside]
    cosine = normal @ direction
    kernel = [1 / 4, 1 / 2, 5 / 16, 0, -3 / 32][: order + 1]  # Legendre coefficients of max(mu, 0)
    error = legendre.legval(cosine, kernel) - np.maximum(cosine, 0)
    return float(np.sqrt(np.mean(error**2) / np.mean(np.maximum(cosine, 0) ** 2)))


@pytest.mark.parametrize("order", [0, 1, 2, 4])
def test_hard_light_errors_on_a_sphere_are_the_closed_forms(ladder: Ladder, order: int) -> None:
    hard = ladder.results[-1]
    assert hard.light.name == "directional45"
    # The counted disc ends a pixel before the outline and perspective hides the rim: within 12 % of it.
    assert hard.rung(f"order {order}").error.value == pytest.approx(expected_error(order), rel=0.12)


def test_natural_light_errors_fall_with_the_order(ladder: Ladder) -> None:
    errors = [pooled(ladder, f"order {order}").error for order in (0, 1, 2)]
    assert errors[0] > 3 * errors[1] > 9 * errors[2]
    assert errors[2] < 0.015


def test_the_path_tracers_noise_falls_with_the_root_of_the_samples(ladder: Ladder) -> None:
    result = ladder.results[0]
    assert result.rung("4 spp").error.value == pytest.approx(2 * result.rung("16 spp").error.value, rel=1e-9)
    assert result.crossover("order 0") < result.crossover("order 2")


def test_records_and_csv_hold_every_model_and_light(ladder: Ladder) -> None:
    records = {record.what: record for record in ladder_records(ladder, "test", 0)}
    record = records["validate.order2.ball.rel_rmse"]
    assert record.interval is not None
    assert record.interval[0] <= record.value <= record.interval[1]
    assert "validate.order2_visibility.ball.directional45.rel_rmse" in records
    rows = list(csv.DictReader(io.StringIO(to_csv(ladder))))
    assert len(rows) == 4 * (4 + 1 + 3)  # four lights; the reference is the third of the path tracer's rungs


def test_the_cheapest_model_within_a_tolerance(ladder: Ladder) -> None:
    assert "is order 2:" in cheapest(ladder, 0.02) or "is order 4:" in cheapest(ladder, 0.02)
    assert "is order 0:" in cheapest(ladder, 0.9)
    assert "path tracing is needed" in cheapest(ladder, 1e-6)


def test_the_command_writes_records_table_and_page(tmp_path: Path) -> None:
    scene = tmp_path / "ball.toml"
    scene.write_text(BALL)
    with pytest.raises(WorkFailed, match="is allowed; see"):
        validate(scene, tmp_path / "out", tolerance=1e-5)
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"records.json", "ladder.csv", "index.html"}
    assert any(r.what == "validate.order2.ball.rel_rmse" for r in read_records(tmp_path / "out/records.json"))
    page = (tmp_path / "out" / "index.html").read_text()
    assert "<script" not in page
    assert 'src="http' not in page


def test_the_demo_needs_a_checkout(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="run the demo in a checkout"):
        run_demo(tmp_path / "out", root=tmp_path)
