"""Runs that begin with trained weights in place of random ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from train.test_trainer import RECIPE as LONGER

from sfsnet_dr.core.errors import InputError, RunError
from sfsnet_dr.core.provenance import sha256
from sfsnet_dr.models.weights import copy_weights, load_weights, read_metadata
from sfsnet_dr.train.config import ModelRecipe
from sfsnet_dr.train.logging import read_history
from sfsnet_dr.train.run import CHECKPOINT, HISTORY, WEIGHTS
from sfsnet_dr.train.trainer import train

RECIPE = replace(LONGER, steps=4, checkpoint_every=2)


@pytest.fixture(scope="module")
def first(spheres: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights to begin with."""
    return train(RECIPE, spheres, tmp_path_factory.mktemp("first"), progress=False).weights


def test_a_run_begins_where_the_other_ended(spheres: Path, first: Path, tmp_path: Path) -> None:
    model = RECIPE.make_model()
    copy_weights(first, model)
    for name, tensor in load_weights(first).state_dict().items():
        assert torch.equal(model.state_dict()[name], tensor)
    train(RECIPE, spheres, tmp_path, progress=False, start=first)
    random, begun = (read_history(folder / HISTORY)[0] for folder in (first.parent, tmp_path))
    assert begun["total"] != random["total"]
    assert read_metadata(tmp_path / WEIGHTS)["start"] == sha256(first)


def test_it_is_gone_on_with_as_if_it_was_never_stopped(
    spheres: Path, first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = train(RECIPE, spheres, tmp_path / "whole", progress=False, start=first).weights
    monkeypatch.setattr("sfsnet_dr.train.run.TrainingRun.finish", _stop)
    with pytest.raises(RunError):
        train(replace(RECIPE, steps=4), spheres, tmp_path / "cut", progress=False, start=first)
    monkeypatch.undo()
    for other in (None, whole):
        with pytest.raises(InputError, match=f"{CHECKPOINT}: begun with weights of SHA-256 .* given; resume"):
            train(RECIPE, spheres, tmp_path / "cut", progress=False, resume=True, start=other)
    again = train(RECIPE, spheres, tmp_path / "cut", progress=False, resume=True, start=first).weights
    assert again.read_bytes() == whole.read_bytes()


def test_weights_of_another_network_are_refused(spheres: Path, first: Path, tmp_path: Path) -> None:
    wider = replace(RECIPE, model=ModelRecipe(stem=8, features=8, blocks=1))
    with pytest.raises(InputError, match=r"stem = 4 found, a sfsnet with .*stem = 8 is to begin with it"):
        train(wider, spheres, tmp_path, progress=False, start=first)


def _stop(_: object) -> None:
    raise RunError("stopped")
