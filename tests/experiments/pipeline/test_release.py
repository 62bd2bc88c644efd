"""Releases: stages in order, labels and averages between them, and a run that resumes to the same weights."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
import torch
from helpers.spheres import SPEC, sphere_bundle
from rich.console import Console

from sfsnet_dr.cli.main import main
from sfsnet_dr.core.errors import InputError, RunError
from sfsnet_dr.data.bundle import write_bundle
from sfsnet_dr.data.manifest import Entry, Manifest
from sfsnet_dr.experiments.pipeline import release as releases
from sfsnet_dr.experiments.pipeline.release import Inputs, plan_release, plan_text, run_release
from sfsnet_dr.experiments.pipeline.release_config import read_release
from sfsnet_dr.models.weights import load_weights

TRAINING = Path(__file__).parents[3] / "training"

TINY = """
name = "tiny"

[recipe]
steps = 2
batch_size = 2

[recipe.model]
architecture = "sfsnet"
stem = 2
features = 2
blocks = 1

[recipe.data]
size = 16
num_lights = 2

[recipe.data.light]
hdr = 0
sun_sky = 0
studio = 0

[faces.balls]
count = 2

[[stage]]
name = "first"
faces = ["balls"]
init = "random"
minutes = 3

[[stage]]
name = "second"
recipe.steps = 3
recipe.optimiser.learning_rate = 0.01

[[stage]]
name = "mean"
kind = "average"
of = ["first", "second"]
coefficients = [1, 3]
"""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A release of two training stages and an average; spheres stand in for faces."""

    def render(folder: Path, *_: object, **__: object) -> None:
        if not folder.is_dir():
            folder.mkdir(parents=True)
            for seed in range(2):
                write_bundle(folder / f"{seed}.exr", sphere_bundle(seed))
                Manifest(folder).append(Entry(f"{seed}.exr", seed, "sphere", SPEC, str(seed)))

    monkeypatch.setattr(releases, "render_missing", render)
    monkeypatch.setattr(releases, "measure_shipped", lambda *_, **__: [])
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return path


def run(file: Path, out: Path) -> None:
    console = Console(file=io.StringIO())
    run_release(read_release(file), out, Inputs(), command="test", console=console)


def test_stages_and_averages_follow_one_another(file: Path, tmp_path: Path) -> None:
    run(file, tmp_path / "out")
    first, second, mean = (
        load_weights(tmp_path / "out" / name / "weights.safetensors").state_dict()
        for name in ("first", "second", "mean")
    )
    for name, values in first.items():
        if values.is_floating_point():
            torch.testing.assert_close(mean[name], 0.25 * values + 0.75 * second[name])
    assert any(not torch.equal(first[name], second[name]) for name in first)
    assert "average first and second" in (tmp_path / "out" / "tiny.md").read_text()
    assert (tmp_path / "out" / "tiny.safetensors").is_file()


def test_a_stopped_run_resumes_to_the_same_weights(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(file, tmp_path / "whole")

    def stop(*_: object) -> None:
        raise RunError("stopped")

    with monkeypatch.context() as patch:
        patch.setattr(releases, "_average", stop)
        with pytest.raises(RunError, match="stopped"):
            run(file, tmp_path / "stopped")
    done = (tmp_path / "stopped" / "second" / "weights.safetensors").stat().st_mtime_ns
    run(file, tmp_path / "stopped")
    assert (tmp_path / "stopped" / "second" / "weights.safetensors").stat().st_mtime_ns == done
    whole, again = (
        (tmp_path / name / "mean" / "weights.safetensors").read_bytes() for name in ("whole", "stopped")
    )
    assert whole == again


def test_the_plan_says_what_is_done_and_what_is_left(file: Path, tmp_path: Path) -> None:
    lines = plan_release(read_release(file), tmp_path / "out", Inputs())
    assert [line.done for line in lines] == [False] * 4
    assert "3 min" in plan_text(lines)
    run(file, tmp_path / "out")
    assert all(line.done for line in plan_release(read_release(file), tmp_path / "out", Inputs()))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            'faces = ["balls"]',
            'faces = ["bals"]',
            r"stage 'first': faces: 'bals' found; did you mean 'balls'",
        ),
        ('of = ["first", "second"]', 'of = ["first"]', "of: 1 stages found"),
        ('of = ["first", "second"]', 'of = ["first", "third"]', "of: 'third' found"),
        ('name = "second"', 'name = "first"', "two stages of this name"),
        ("recipe.steps = 3", "recipe.stepz = 3", "unknown key 'stepz'"),
        ("recipe.steps = 3", "recipe.normal_labels.batch_fraction = 0.5", "no stage of labels found"),
        ("count = 2", "count = 0", r"faces\.balls: count 0"),
    ],
)
def test_stages_that_do_not_fit_are_refused(file: Path, old: str, new: str, words: str) -> None:
    file.write_text(TINY.replace(old, new))
    with pytest.raises(InputError, match=words):
        read_release(file)


@pytest.mark.parametrize("name", ["skipnet", "sfsnet", "skipnet-plus"])
def test_releases_are_read_and_name_what_is_missing(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = TRAINING / "release" / f"{name}.toml"
    images = {"skipnet": 381_552, "sfsnet": 141_200, "skipnet-plus": 102_080}  # as the cards say
    recipes = read_release(path).recipes.values()
    assert sum(recipe.steps * recipe.batch_size for recipe in recipes) == images[name]
    assert main(["train-all", str(path), "--out", str(tmp_path / "out"), "--dry-run"]) == 0
    plan = capfd.readouterr().out
    assert "missing: --database" in plan
    assert "missing: --model-path" in plan
    assert main(["train-all", str(path), "--out", str(tmp_path / "out")]) == 2
    assert f"{name}: ict needs --model-path" in capfd.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "out").exists()


def test_options_of_the_other_kind_of_file_are_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    release, out = str(TRAINING / "release" / "skipnet.toml"), str(tmp_path / "out")
    assert main(["train-all", release, "--out", out, "--rendered-photographs"]) == 2
    assert "--rendered-photographs: has no effect" in capfd.readouterr().err
    assert main(["train-all", str(TRAINING / "small.toml"), "--out", out, "--dry-run"]) == 2
    assert "--dry-run: has no effect" in capfd.readouterr().err
