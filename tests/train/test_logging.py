"""What is told about every step of a run: lines of JSON, and TensorBoard where it is installed."""

from __future__ import annotations

import json
import sys
import types
from dataclasses import replace
from pathlib import Path

import pytest
from train.test_trainer import RECIPE

from sfsnet_dr.core.errors import InputError, NotInstalled
from sfsnet_dr.train.logging import History, read_history
from sfsnet_dr.train.run import HISTORY
from sfsnet_dr.train.trainer import train


def test_tensorboard_is_an_extra(spheres: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *_: None)
    with pytest.raises(NotInstalled, match=r"pip install 'sfsnet_dr\[tensorboard\]'"):
        train(RECIPE, spheres, tmp_path, progress=False, tensorboard=True)


def test_tensorboard_gets_the_numbers_of_every_step(
    spheres: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[tuple[str, int]] = []

    class Writer:
        def __init__(self, folder: str, purge_step: int) -> None:
            assert (folder, purge_step) == (str(tmp_path / "tensorboard"), 0)

        def add_scalar(self, name: str, value: float, step: int) -> None:
            written.append((name, step))

        def close(self) -> None:
            written.append(("closed", 0))

    fake = types.ModuleType("torch.utils.tensorboard.writer")
    fake.SummaryWriter = Writer  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", types.ModuleType("torch.utils.tensorboard"))
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard.writer", fake)
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *_: object())
    train(replace(RECIPE, steps=2), spheres, tmp_path, progress=False, tensorboard=True)
    assert {("total", 0), ("total", 1), ("rate", 1), ("images_per_second", 0)} <= set(written)
    assert written[-1] == ("closed", 0)


def test_a_torn_history_line_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / HISTORY
    path.write_text(json.dumps({"step": 0}) + "\n" + json.dumps({"step": 1}) + "\n" + '{"ste')
    assert read_history(path) == [{"step": 0}, {"step": 1}]
    with History(path, 1) as history:
        history.add(step=1, total=2.0)
    assert read_history(path) == [{"step": 0}, {"step": 1, "total": 2.0}]
    path.write_text("{\n")
    with pytest.raises(InputError, match=HISTORY):
        read_history(path)
