"""Runs: a resumed one equals one that was never stopped, whatever stopped it."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.spheres import write_spheres
from safetensors.torch import save_file

from sfsnet_dr.core.errors import InputError, RunError
from sfsnet_dr.core.image_io import read_image
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.models.weights import load_weights, read_metadata
from sfsnet_dr.scene.lights.spec import LightSpec
from sfsnet_dr.train.checkpoint import previous_path
from sfsnet_dr.train.config import ComputeRecipe, ModelRecipe, Recipe
from sfsnet_dr.train.logging import read_history
from sfsnet_dr.train.run import CHECKPOINT, HISTORY, WEIGHTS
from sfsnet_dr.train.step import NonFiniteError, training_step
from sfsnet_dr.train.trainer import train

RECIPE = Recipe(
    steps=9,
    batch_size=2,
    checkpoint_every=4,
    model=ModelRecipe(stem=4, features=8, blocks=1),
    data=Augmentation(
        num_lights=4, light=LightSpec(hdr=0, sun_sky=0, studio=0, directional=1, ambient=0, lobes=1)
    ),
    compute=ComputeRecipe(precision="float32", loss_backend="torch"),
)


@pytest.fixture(scope="module")
def whole(spheres: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run from beginning to end."""
    folder = tmp_path_factory.mktemp("whole")
    train(RECIPE, spheres, folder, progress=False)
    return folder


def before_step(monkeypatch: pytest.MonkeyPatch, number: int, act: Callable[[], object]) -> None:
    """Do something when a run begins its step ``number``, counted from this call."""
    calls = iter(range(1000))

    def patched(*arguments: Any) -> dict[str, float]:
        if next(calls) == number:
            act()
        return training_step(*arguments)

    monkeypatch.setattr("sfsnet_dr.train.run.training_step", patched)


def fail(error: BaseException) -> Callable[[], object]:
    """A function that raises."""

    def act() -> object:
        raise error

    return act


def losses(folder: Path) -> list[dict[str, Any]]:
    """The history without what depends on the clock."""
    lines = read_history(folder / HISTORY)
    return [{key: line[key] for key in line if key != "images_per_second"} for line in lines]


def same_run(a: Path, b: Path) -> bool:
    """Whether weights and history are equal to the bit."""
    equal: bool = (a / WEIGHTS).read_bytes() == (b / WEIGHTS).read_bytes() and losses(a) == losses(b)
    return equal


def test_a_run_leaves_weights_history_and_means(spheres: Path, tmp_path: Path) -> None:
    result = train(RECIPE, spheres, tmp_path / "run", progress=False)
    lines = read_history(result.history)
    assert [line["step"] for line in lines] == list(range(9))
    assert set(lines[0]) >= {"rate", "total", "recon", "normal", "albedo", "light", "images_per_second"}
    assert result.final["total"] == pytest.approx(sum(line["total"] for line in lines) / 9)
    assert result.skipped == 0
    load_weights(result.weights)
    metadata = read_metadata(result.weights)
    assert metadata["recipe"]["model"]["features"] == 8
    assert metadata["final"] == result.final


def test_a_crash_between_checkpoints_costs_nothing_but_time(
    spheres: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        before_step(patch, 6, fail(RuntimeError("power cut")))
        with pytest.raises(RuntimeError):
            train(RECIPE, spheres, tmp_path, progress=False)
    assert len(losses(tmp_path)) == 6  # two of them after the checkpoint of step 4
    assert not (tmp_path / WEIGHTS).exists()
    train(RECIPE, spheres, tmp_path, resume=True, progress=False)
    assert same_run(whole, tmp_path)


@pytest.mark.parametrize(
    ("number", "error"), [(signal.SIGTERM, RunError), (signal.SIGINT, KeyboardInterrupt)]
)
def test_a_signal_saves_after_the_step(
    number: signal.Signals,
    error: type[BaseException],
    spheres: Path,
    whole: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    handler = signal.getsignal(number)
    with monkeypatch.context() as patch:
        before_step(patch, 2, lambda: signal.raise_signal(number))
        with pytest.raises(error):
            train(RECIPE, spheres, tmp_path, progress=False)
    assert signal.getsignal(number) == handler
    assert len(losses(tmp_path)) == 3
    train(RECIPE, spheres, tmp_path, resume=True, progress=False)
    assert same_run(whole, tmp_path)


def test_resuming_a_finished_run_changes_nothing(spheres: Path, whole: Path) -> None:
    before = (whole / WEIGHTS).read_bytes()
    train(RECIPE, spheres, whole, resume=True, progress=False)
    assert (whole / WEIGHTS).read_bytes() == before


def test_another_seed_is_another_run(spheres: Path, whole: Path, tmp_path: Path) -> None:
    train(replace(RECIPE, seed=1), spheres, tmp_path, progress=False)
    assert not same_run(whole, tmp_path)


@pytest.mark.parametrize("architecture", ["skipnet", "skipnet-plus"])
def test_one_trainer_trains_every_network(architecture: str, tmp_path: Path) -> None:
    recipe = replace(
        RECIPE,
        steps=2,
        model=ModelRecipe(architecture, width=2),
        data=replace(RECIPE.data, size=32),
    )
    result = train(recipe, write_spheres(tmp_path / "faces", 2, size=32), tmp_path / "run", progress=False)
    assert load_weights(result.weights).architecture == architecture
    assert [line["step"] for line in read_history(result.history)] == [0, 1]


def test_runs_are_not_mixed(spheres: Path, whole: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds a run already"):
        train(RECIPE, spheres, whole, progress=False)
    with pytest.raises(InputError, match="no checkpoint to resume from"):
        train(RECIPE, spheres, tmp_path / "new", resume=True, progress=False)
    with pytest.raises(InputError, match=r"recipe with data\.flip = 0\.5 found, 0\.1 asked for"):
        train(
            replace(RECIPE, data=replace(RECIPE.data, flip=0.1)),
            spheres,
            whole,
            resume=True,
            progress=False,
        )
    others = write_spheres(tmp_path / "others", 2)
    with pytest.raises(InputError, match="trained on other bundles"):
        train(RECIPE, others, whole, resume=True, progress=False)
    (tmp_path / CHECKPOINT).write_bytes((whole / WEIGHTS).read_bytes())
    with pytest.raises(InputError, match=r"sfsnet_dr\.weights found in its header"):
        train(RECIPE, spheres, tmp_path, resume=True, progress=False)


def test_a_step_that_is_not_finite_is_skipped_and_told(
    spheres: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before_step(monkeypatch, 3, fail(NonFiniteError("recon not finite")))
    result = train(RECIPE, spheres, tmp_path, progress=False)
    assert result.skipped == 1
    line = read_history(result.history)[3]
    assert line["skipped"] == "recon not finite"
    assert len(line["faces"]) == 2
    assert line["faces"][0].startswith("sphere_")


def test_too_many_such_steps_end_the_run(
    spheres: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "sfsnet_dr.train.run.training_step", lambda *_: fail(NonFiniteError("total not finite"))()
    )
    with pytest.raises(RunError, match=r"3 steps were not finite \(2 allowed\); the last, 2, had total"):
        train(replace(RECIPE, max_skipped_steps=2), spheres, tmp_path, progress=False)


def test_a_failure_leaves_no_bar_in_a_log(
    spheres: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    before_step(monkeypatch, 1, fail(RuntimeError("power cut")))
    with pytest.raises(RuntimeError):
        train(RECIPE, spheres, tmp_path, progress=True)
    assert capfd.readouterr().err == ""


def test_a_damaged_checkpoint_is_replaced_by_the_one_before(
    spheres: Path, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    train(RECIPE, spheres, tmp_path, progress=False)
    last = tmp_path / CHECKPOINT
    assert previous_path(last).is_file()
    last.write_bytes(last.read_bytes()[:1000])
    train(RECIPE, spheres, tmp_path, resume=True, progress=False)  # from step 8 again
    assert same_run(whole, tmp_path)
    assert "going on from checkpoint.previous.safetensors" in " ".join(capsys.readouterr().err.split())
    for path in (last, previous_path(last)):
        path.write_bytes(b"nothing")
    with pytest.raises(InputError, match="not a checkpoint"):
        train(RECIPE, spheres, tmp_path, resume=True, progress=False)


def test_a_full_disk_ends_the_run_with_the_last_checkpoint_whole(
    spheres: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved = iter(range(100))

    def full(*arguments: Any) -> None:
        if next(saved) == 1:
            arguments[1].write_bytes(b"half of i")
            raise OSError(errno.ENOSPC, "No space left on device")
        save_file(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr("sfsnet_dr.train.checkpoint.save_file", full)
        with pytest.raises(RunError, match=r"No space left on device.*make room and go on with --resume"):
            train(RECIPE, spheres, tmp_path, progress=False)
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".partial")]
    train(RECIPE, spheres, tmp_path, resume=True, progress=False)
    assert same_run(whole, tmp_path)


KILLED = """
import os, signal, sys
sys.path.insert(0, sys.argv[1])
from train.test_trainer import RECIPE
import sfsnet_dr.train.run as run
step, calls = run.training_step, iter(range(100))
def killing(*arguments):
    if next(calls) == 6:
        os.kill(os.getpid(), signal.SIGKILL)
    return step(*arguments)
run.training_step = killing
from sfsnet_dr.train.trainer import train
train(RECIPE, sys.argv[2], sys.argv[3], progress=False)
"""


@pytest.mark.slow
def test_a_killed_run_ends_as_one_that_was_not(spheres: Path, whole: Path, tmp_path: Path) -> None:
    place = os.environ | {"OMP_NUM_THREADS": str(torch.get_num_threads())}
    command = [sys.executable, "-c", KILLED, str(Path(__file__).parents[1]), str(spheres), str(tmp_path)]
    assert subprocess.run(command, env=place, check=False).returncode == -signal.SIGKILL
    assert len(losses(tmp_path)) == 6
    train(RECIPE, spheres, tmp_path, resume=True, progress=False)
    assert same_run(whole, tmp_path)


def test_pictures_are_drawn_every_so_often_and_change_nothing(
    spheres: Path, whole: Path, tmp_path: Path
) -> None:
    train(replace(RECIPE, log_images_every=4), spheres, tmp_path, progress=False)
    assert sorted(path.name for path in tmp_path.glob("*.png")) == [
        "pictures-000004.png",
        "pictures-000008.png",
    ]
    assert read_image(tmp_path / "pictures-000008.png").pixels.shape == (2 * 16, 9 * 16, 3)
    drawn, plain = (load_weights(folder / WEIGHTS).state_dict() for folder in (tmp_path, whole))
    assert all(torch.equal(drawn[name], plain[name]) for name in plain)
