"""The measured on a sphere, where every model's error is known, and what the command leaves behind."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfsnet_dr.cli.main import main
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.experiments.demo.run import run_demo
from sfsnet_dr.experiments.validation import page, run
from sfsnet_dr.experiments.validation.measure import measure_models
from sfsnet_dr.experiments.validation.page import scene_section, write_study_page
from sfsnet_dr.experiments.validation.records import STORED_LIGHT, main_records, study_records, to_csv
from sfsnet_dr.experiments.validation.renderers import chosen_renderers
from sfsnet_dr.experiments.validation.run import Request, measure_scene, validate
from sfsnet_dr.experiments.validation.summary import (
    Study,
    all_candidates,
    cheapest_model,
    format_duration,
    pooled_error,
    summary_sentence,
)
from sfsnet_dr.metrics.image import has_flip
from sfsnet_dr.report.record import read_records
from sfsnet_dr.scene.lights.equirect import MAP_SIZE
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.lights.presets import light_set
from sfsnet_dr.scene.mesh import move_mesh
from sfsnet_dr.scene.spec import CameraSpec, SamplingSpec, SceneSpec
from sfsnet_dr.scene.subject import Subject, build_subject

LIGHTS = "natural,directional60"


def subject_of(shape: str, **more: object) -> Subject:
    sampling = SamplingSpec(spp=32, paths_per_hit=4, reference_spp=64)
    spec = SceneSpec("ball", "sphere", camera=CameraSpec(size=32), sampling=sampling)
    return build_subject(replace(spec, shape=shape, **more))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def study() -> Study:
    return measure_scene(
        subject_of("sphere"), light_set(LIGHTS), ["drjit-order2", "mitsuba-llvm-path"], cold=False
    )


def expected_error(order: int, angle: float) -> float:
    """Relative RMS error of an order under a lamp, by quadrature over the visible hemisphere."""
    from numpy.polynomial import legendre

    x, y = np.meshgrid(np.linspace(-1, 1, 801), np.linspace(-1, 1, 801))
    inside = x**2 + y**2 < 0.97
    normal = np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1)[inside]
    cosine = normal @ np.array([np.sin(np.radians(angle)), 0.0, np.cos(np.radians(angle))])
    kernel = [1 / 4, 1 / 2, 5 / 16, 0, -3 / 32][: order + 1]  # Legendre coefficients of max(mu, 0)
    error = legendre.legval(cosine, kernel) - np.maximum(cosine, 0)
    return float(np.sqrt(np.mean(error**2) / np.mean(np.maximum(cosine, 0) ** 2)))


@pytest.mark.parametrize("order", [0, 1, 2, 3, 4])
def test_errors_under_a_lamp_on_a_sphere_are_the_closed_forms(study: Study, order: int) -> None:
    hard = study.scene.results[-1]
    assert hard.light.name == "directional60"
    row = hard.row(f"order{order}")
    # The counted disc ends a pixel before the outline and perspective hides the rim: within 12 % of it.
    assert row.errors.rel.value == pytest.approx(expected_error(order, 60), rel=0.12)
    assert row.parts["truncation"].share == pytest.approx(1.0, abs=0.02)  # nothing else is wrong on a ball
    assert sum(part.share for part in row.parts.values()) == pytest.approx(1.0)


def test_natural_errors_fall_with_the_order_and_shadows_help_no_convex_body(study: Study) -> None:
    errors = {model.key: pooled_error(study, model.key, study.natural).error for model in study.models}
    assert errors["order0"] > 3 * errors["order1"] > 9 * errors["order2"]
    assert errors["order2"] < 0.02
    assert errors["order2_visibility"] == pytest.approx(errors["order2"], abs=0.005)


def test_a_cast_shadow_and_a_bounce_are_seen_where_they_are() -> None:
    lights = light_set("directional30,constant")
    spheres = measure_models(subject_of("two_spheres"), lights).results
    bowl = measure_models(subject_of("bowl", albedo=(0.7, 0.7, 0.7)), lights).results
    shadow = spheres[1].row("order4").parts
    assert shadow["visibility"].size > 0.2
    assert shadow["visibility"].share > 0.5
    # Under a constant sky the bowl's rim hides half of it and its walls give part of that back.
    hidden = bowl[0].row("order2").parts
    assert hidden["visibility"].size > 0.3
    assert hidden["interreflection"].size > 0.2
    assert hidden["interreflection"].share < 0
    better = [bowl[0].row(key).errors.rel.value for key in ("order2", "order4_visibility", "order4_bounce")]
    assert better[2] < min(better[:2])  # shadows alone may be worse than nothing: bounces offset them


def test_the_path_tracers_noise_and_its_crossover(study: Study) -> None:
    result = study.scene.results[0]
    noise = {path.samples: path.noise for path in result.paths}
    assert noise[4] == pytest.approx(2 * noise[16], rel=1e-9)
    assert result.crossover("order0") < result.crossover("order2")


def test_registered_renderers_agree_with_the_ladder(study: Study) -> None:
    compared = {(other.renderer, other.light): other for other in study.renderers}
    ours = compared["drjit-order2", "directional60"]
    assert ours.errors is not None
    row = study.scene.results[-1].row("order2")
    assert ours.errors.rel.value == pytest.approx(row.errors.rel.value, rel=0.02)
    path = compared["mitsuba-llvm-path", "directional60"]
    assert path.errors is not None
    assert path.errors.rel.value < 0.01 < row.errors.rel.value  # the same truth by other paths
    assert path.noise > 0


def test_a_renderer_of_another_package_is_measured_under_every_light(
    study: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (run, page):
        monkeypatch.setattr(module, "is_built_in", lambda name: name != "torch-order2")
    found = run._compare(study.scene, ["drjit-order2", "torch-order2"])
    lights = [result.light.name for result in study.scene.results]
    assert [each.light for each in found if each.renderer == "torch-order2"] == lights
    assert len([each for each in found if each.renderer == "drjit-order2"]) == 2
    for result, each in zip(study.scene.results, found[2:], strict=True):
        assert each.errors is not None
        expected = result.row("order2").errors.rel.value
        assert each.errors.rel.value == pytest.approx(expected, rel=0.02, abs=1e-3)
    table = page.other_renderers_table(replace(study, renderers=found))
    assert table is not None
    assert [row[0] for row in table.rows] == lights
    monkeypatch.setattr(page, "is_built_in", lambda name: True)
    assert page.other_renderers_table(study) is None


def test_records_and_csv_hold_every_model_and_light(study: Study) -> None:
    records = {record.what: record for record in study_records(study, 0.05, "test", 0)}
    for name in ("validate.order2.ball", "validate.order2_visibility.ball.directional60"):
        record = records[f"{name}.rel_rmse"]
        assert record.interval is not None
        assert record.interval[0] <= record.value <= record.interval[1]
    assert records["validate.order2.ball.directional60.cause.truncation"].value > 0.05
    assert records["validate.order2.ball.share.copy_bandwidth"].value > 0
    assert records["validate.drjit-order2.ball.natural0.rel_rmse"].value < 0.02
    rows = list(csv.DictReader(io.StringIO(to_csv(study))))
    assert len(rows) == 4 * (9 + 2 + 4) + 2 * 2  # lights times (models, limits, paths), renderers
    assert {row["model"] for row in rows} >= {"order0", "order4_bounce", "path_direct", "path_16spp"}


def test_stored_records_leave_out_what_the_csv_has(study: Study) -> None:
    records = study_records(study, 0.05, "test", 0)
    stored = {record.what for record in main_records(records)}
    assert "validate.order2.ball.rel_rmse" in stored
    assert f"validate.order2.ball.{STORED_LIGHT}.rel_rmse" in stored
    assert "validate.order2.ball.time.frozen" in stored
    assert f"validate.order2.ball.{STORED_LIGHT}.cause.truncation" not in stored
    with_light = {
        what for what in stored if what.split(".")[3] not in ("rel_rmse", "seconds", "time", "share")
    }
    rows = {
        (row["model"], row["light"]): float(row["rel_rmse"])
        for row in csv.DictReader(io.StringIO(to_csv(study)))
    }
    for record in records:
        _, model, _, light, *what = record.what.split(".")
        if what == ["rel_rmse"]:
            assert rows[model, light] == pytest.approx(record.value, rel=1e-4)
    assert all(what.endswith((f".{STORED_LIGHT}.rel_rmse", ".cause.spectral")) for what in with_light)


def test_times_are_taken_apart(study: Study) -> None:
    times = study.times["order2"]
    warm = times.warm
    assert warm.execution > 0
    assert warm.tracing + warm.codegen + warm.backend + warm.execution == pytest.approx(warm.total, rel=1e-6)
    assert 0.01 < times.copy_share < 5
    assert times.ns_per_pixel > 0.1


def test_the_sentence_names_the_cheapest_within_the_tolerance(study: Study) -> None:
    quick = cheapest_model(study, 0.08)
    assert quick is not None
    assert quick.error <= 0.08
    assert all(c.error > 0.08 for c in all_candidates(study) if c.seconds < quick.seconds)
    assert "No model stays within 1e-06 %" in summary_sentence(study, 1e-8)
    assert f"under all 4 lights is {quick.name}: " in summary_sentence(study, 0.08)


@pytest.mark.parametrize(("seconds", "text"), [(1.234, "1.2 s"), (0.0321, "32 ms"), (2.4e-4, "240 \u00b5s")])
def test_durations_have_two_digits(seconds: float, text: str) -> None:
    assert format_duration(seconds) == text


def test_the_page_is_self_contained_and_shows_every_model(study: Study, tmp_path: Path) -> None:
    record = study_records(study, 0.05, "sfsnet-dr validate --scene ball", 0)[0]
    write_study_page(tmp_path / "index.html", study, 0.05, record)
    page = (tmp_path / "index.html").read_text()
    assert "<script" not in page
    assert 'src="http' not in page
    assert all(model.name in page for model in study.models)
    assert "flip-evaluator" in page or has_flip()
    assert scene_section(study, 0.05).heading == "The scene ball"  # as the demo's page shows it


@pytest.mark.slow  # compiles everything anew in another process
def test_the_command_writes_everything(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    arguments = (
        "--scene sphere --lights constant,directional60 --size 24 --samples 16 --renderers torch-order2"
    )
    assert main(["validate", *arguments.split(), "--out", str(out), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert {p.name for p in out.iterdir()} == {
        "records.json",
        "errors.csv",
        "pareto.png",
        "maps",
        "index.html",
    }
    assert len(read_records(out / "records.json")) == len(printed)
    assert "validate.order2.sphere.time.cold" in {record["what"] for record in printed}


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (Request("sphre"), "did you mean 'sphere'"),
        (Request("sphere", "directionl0"), "did you mean 'directional0'"),
        (Request("sphere", renderers="drjit-order22"), "did you mean 'drjit-order2'"),
        (Request("sphere", tolerance=0.0), "--tolerance: 0 found"),
        (Request("sphere", samples=1), "--samples: 1 found"),
        (Request("sphere", size=4), "--size: 4 found"),
    ],
)
def test_wrong_requests_are_answered_before_any_work(tmp_path: Path, request_: Request, words: str) -> None:
    with pytest.raises(InputError, match=words):
        validate(request_, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_nothing_in_view_and_no_light_are_answered() -> None:
    ball = subject_of("sphere")
    away = Subject(ball.spec, 0, move_mesh(ball.mesh, (9.0, 0.0, 0.0)), ball.camera)
    with pytest.raises(InputError, match="ball: no surface in view"):
        measure_models(away, light_set("constant"))
    with pytest.raises(InputError, match="light 'night': all zeros"):
        measure_models(ball, [Light("night", np.zeros((*MAP_SIZE, 3)))])
    with pytest.raises(InputError, match="lights: none found"):
        measure_models(ball, [])
    assert chosen_renderers("none") == ()


def test_the_demo_needs_a_checkout(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="run the demo in a checkout"):
        run_demo(tmp_path / "out", root=tmp_path)
