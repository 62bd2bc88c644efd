"""A scene's ``[light]`` table is honoured, or refused by commands that choose lights themselves."""

from __future__ import annotations

from pathlib import Path

import pytest

from sfsnet_dr.cli.main import main

RECIPES = Path(__file__).parents[2] / "training"
SCENE = 'name = "lit"\nshape = "{shape}"\n[light]\nstudio = 1.0\n'
REFUSED = "a [light] table found, which has no effect here"


@pytest.mark.parametrize("command", ["validate --scene {scene}", "worst-light --scene {scene}"])
def test_validation_refuses_it(command: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "lit.toml"
    scene.write_text(SCENE.format(shape="sphere"))
    out = tmp_path / "out"
    assert main([*command.format(scene=scene).split(), "--out", str(out)]) == 2
    told = capfd.readouterr().err
    assert f"{scene}: {REFUSED}: the command chooses the lights" in told
    assert not out.exists()


def test_training_refuses_it(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "lit.toml"
    scene.write_text(SCENE.format(shape="anny"))
    recipe = next(RECIPES.rglob("smoke.toml"))
    arguments = ["train", str(recipe), "--scene", str(scene), "--out", str(tmp_path / "out")]
    assert main(arguments) == 2
    assert f"{scene}: {REFUSED}: training images are lit as the recipe" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()
