"""Recipes: the values they give, the learning rate they describe, and what they refuse."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.train.config import ComputeRecipe, OptimiserRecipe, Recipe, read_recipe

RECIPES = sorted((Path(__file__).parents[2] / "training" / "recipes").rglob("*.toml"))


def test_a_recipe_without_sections_is_the_papers(tmp_path: Path) -> None:
    path = tmp_path / "r.toml"
    path.write_text("steps = 5\n")
    recipe = read_recipe(path)
    assert recipe == Recipe(steps=5)
    assert recipe.model.config == {"stem": 64, "features": 128, "blocks": 5}
    weights = recipe.loss
    assert (weights.recon, weights.normal, weights.albedo, weights.light) == (0.5, 0.5, 0.5, 0.1)


def test_a_skipnet_is_made_for_the_size_of_its_images(tmp_path: Path) -> None:
    path = tmp_path / "r.toml"
    path.write_text("steps = 5\n[model]\narchitecture = 'skipnet'\nwidth = 4\n[data]\nsize = 64\n")
    assert read_recipe(path).make_model().config == {"width": 4, "size": 64}


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_recipes_of_the_repository_are_read(path: Path) -> None:
    assert read_recipe(path).steps > 0
    assert path.read_text().startswith("#"), "a recipe begins with its cost, command and expected numbers"


def test_there_are_recipes() -> None:
    assert RECIPES


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("stepz = 5", "unknown key 'stepz'; did you mean 'steps'"),
        ("batch_size = 4", "key 'steps' is missing"),
        ("steps = 5\n[data]\nflipp = 1.0", "data: unknown key 'flipp'; did you mean 'flip'"),
        ("steps = 2.5", "steps: 2.5 found"),
        ("steps = true", "steps: True found"),
        ("steps = 0", "steps: 0 found, more than 0"),
        ("steps = 5\n[data]\nflip = 2.0", "flip: 2.0 found"),
        ("steps = 5\n[optimiser]\nlearning_rate = -1", "learning_rate: -1.0 found"),
        ("steps = 5\n[model]\narchitecture = 'sfsnot'", "'sfsnot' found; did you mean 'sfsnet'"),
        ("steps = 5\n[model]\nblocks = 0", "blocks: 0 found"),
        (
            "steps = 5\n[model]\narchitecture = 'skipnet'\nstem = 4",
            "skipnet configuration: unknown key 'stem'",
        ),
        (
            "steps = 5\n[model]\narchitecture = 'skipnet'\n[data]\nsize = 16",
            "size: 16 found, a multiple of 32",
        ),
        ("steps = 5\n[compute]\nloss_backend = 'numpy'", "'numpy' found; allowed: drjit, drjit-plain, torch"),
        ("steps = 5\n[compute]\nprecision = 'float16'", "'float16' found; did you mean"),
        ("steps = ", "not valid TOML"),
    ],
)
def test_wrong_recipes_are_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "r.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_recipe(path)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_learning_rate_warms_up_and_falls_as_a_cosine() -> None:
    optimiser = OptimiserRecipe(learning_rate=1.0, warmup_steps=4, final_lr_ratio=0.2)
    rates = [optimiser.rate(step, 105) for step in range(105)]
    assert rates[:5] == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])
    assert rates[54] == pytest.approx(0.6)  # half way, the mean of 1 and 0.2
    assert rates[104] == pytest.approx(0.2)
    assert rates[4:] == sorted(rates[4:], reverse=True)
    constant = OptimiserRecipe(learning_rate=1.0, warmup_steps=0, final_lr_ratio=1.0)
    assert [constant.rate(step, 9) for step in range(9)] == [1.0] * 9


def test_precision_is_as_asked() -> None:
    cpu = torch.device("cpu")
    assert ComputeRecipe(precision="bfloat16").bfloat16(cpu)
    assert not ComputeRecipe(precision="float32").bfloat16(cpu)
