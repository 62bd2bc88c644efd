"""Windows of batches: whole pixels of every map at one place, the same for all processes, and learnt from."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from spheres import write_spheres
from torch import Tensor

from sfsnet_dr.data.augment import Augmentation
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.mixture import MixedBatch
from sfsnet_dr.data.window import cut
from sfsnet_dr.fit.history import read_history
from sfsnet_dr.fit.recipe import ComputeRecipe, ModelRecipe, Recipe
from sfsnet_dr.fit.trainer import train
from sfsnet_dr.model.network import Network
from sfsnet_dr.model.outputs import Decomposition


def numbered(count: int, height: int, width: int, first: float) -> FaceBatch:
    """Every pixel of every map says where it is."""
    places = torch.arange(height * width, dtype=torch.float32).reshape(1, 1, height, width)
    images = torch.arange(count, dtype=torch.float32)[:, None, None, None] * 1e4 + places
    image, normal, albedo = (images.expand(-1, 3, -1, -1) + first + 1e5 * number for number in range(3))
    return FaceBatch(image, normal, albedo, torch.arange(count * 27.0).reshape(count, 27), images + 7e5)


def test_all_maps_are_cut_at_one_place() -> None:
    labelled, real = numbered(2, 6, 8, 0.0), numbered(3, 6, 8, 0.5)
    whole = MixedBatch(labelled, real, real.mask + 0.25, free_scale=True)
    part = cut(whole, 4, seed=0, step=3)
    assert part.free_scale
    place = int(part.labelled.image[0, 0, 0, 0])
    row, column = divmod(place, 8)
    for a, b in ((whole.labelled, part.labelled), (whole.real, part.real)):
        assert torch.equal(a.light, b.light)
        for name in ("image", "normal", "albedo", "mask"):
            expected = getattr(a, name)[..., row : row + 4, column : column + 4]
            assert torch.equal(getattr(b, name), expected)
            assert getattr(b, name).is_contiguous()
    assert torch.equal(part.confidence, whole.confidence[..., row : row + 4, column : column + 4])
    assert torch.equal(cut(whole.labelled, 4, seed=0, step=3).image, part.labelled.image)


def test_every_place_comes_and_depends_on_seed_and_step_alone() -> None:
    batch = numbered(1, 6, 8, 0.0)

    def places(seed: int) -> list[tuple[int, int]]:
        cuts = (cut(batch, 4, seed, step).image[0, 0, 0, 0] for step in range(200))
        return [divmod(int(value), 8) for value in cuts]

    assert set(places(0)) == set(itertools.product(range(3), range(5)))
    columns = [column for _, column in places(0)]
    assert columns.count(2) > 2 * columns.count(0)  # 11 in 25 against 2 in 25
    assert places(0) == places(0) != places(1)


def test_a_run_learns_from_windows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[torch.Size] = []
    recipe = Recipe(
        steps=2,
        batch_size=2,
        model=ModelRecipe(stem=4, features=8, blocks=1),
        data=Augmentation(lights=2, window=12),
        compute=ComputeRecipe(precision="float32", loss_backend="torch"),
    )
    network = type(recipe.make_model())
    forward = network.forward

    def watched(self: Network, image: Tensor) -> Decomposition:
        seen.append(image.shape)
        return forward(self, image)

    monkeypatch.setattr(network, "forward", watched)
    faces = write_spheres(tmp_path / "faces", 2)
    a = train(recipe, [faces], tmp_path / "a", progress=False)
    assert seen == [torch.Size([2, 3, 12, 12])] * 2
    whole = replace(recipe, data=replace(recipe.data, window=None))
    b = train(whole, [faces], tmp_path / "b", progress=False)
    assert read_history(a.history)[0]["total"] != read_history(b.history)[0]["total"]
