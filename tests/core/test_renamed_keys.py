"""Old keys of TOML files are refused with the new name, in every dataclass that lists some."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest

from sfsnet_dr.core.config import build_dataclass
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.mixed_batch import PseudoLabelOptions
from sfsnet_dr.data.normal_dataset import NormalLabelOptions
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.data.transforms.camera import PhotoOptions
from sfsnet_dr.experiments.pipeline.config import StagesSpec
from sfsnet_dr.scene.lights.spec import LightSpec
from sfsnet_dr.scene.spec import HeadSpec, SamplingSpec
from sfsnet_dr.train.config import OptimiserRecipe, Recipe

CLASSES = (
    Augmentation,
    HeadSpec,
    LightSpec,
    NormalLabelOptions,
    OptimiserRecipe,
    PhotoOptions,
    PseudoLabelOptions,
    Recipe,
    SamplingSpec,
    StagesSpec,
)


@pytest.mark.parametrize(
    ("kind", "old", "new"), [(kind, *pair) for kind in CLASSES for pair in kind.RENAMED.items()]
)
def test_an_old_key_is_refused_with_the_new_one(kind: type[Any], old: str, new: str) -> None:
    names = {field.name for field in fields(kind)}
    assert new in names
    assert old not in names
    with pytest.raises(InputError, match=f"file: '{old}' is now called '{new}'"):
        build_dataclass(kind, {old: 1}, "file")
