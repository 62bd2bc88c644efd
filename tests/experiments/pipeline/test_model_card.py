"""Weights that come with the package: kept in eight bits, found by name."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.experiments.pipeline.model_card import card_records, compare_with_card, measure_shipped
from sfsnet_dr.models.inference import load_model
from sfsnet_dr.models.sfsnet import SfSNet
from sfsnet_dr.models.shipped import BEST, SHIPPED, weights_name, weights_path
from sfsnet_dr.models.weights import STEP, from_eight_bit, load_weights, save_weights, to_eight_bit


def test_the_network_that_is_used_unasked_has_the_best_normals() -> None:
    what = "synthetic.normals.mean_deg"
    cards = {name: {record.what: record.value for record in card_records(name)} for name in SHIPPED}
    errors = {name: card[f"{what}.{name}"] for name, card in cards.items()}
    assert min(errors, key=errors.__getitem__) == BEST


@pytest.mark.parametrize("scale", [1e-4, 1.0, 300.0])
def test_eight_bits_keep_weights_to_half_a_step(scale: float) -> None:
    generator = torch.Generator().manual_seed(5)
    weight = scale * torch.randn(7, 5, 3, 3, generator=generator)
    weight[2] = 0
    kept = to_eight_bit({"w": weight, "b": weight[0, 0, 0], "n": torch.tensor(3)})
    assert kept["w"].dtype == torch.int8
    back = from_eight_bit(kept)
    assert set(back) == {"w", "b", "n"}
    assert torch.equal(back["b"], weight[0, 0, 0])
    error = (back["w"] - weight).abs().flatten(1).amax(1)
    largest = weight.abs().flatten(1).amax(1)
    # Half a step of 1/127 of the largest; half precision rounds the step up by 2^-10 of it, or to the least
    # subnormal number, 6e-8.
    assert bool((error <= 0.5 * (largest / 127 * (1 + 2**-9) + 1.2e-7)).all())
    assert kept["w" + STEP].shape == (7,)


def test_a_network_in_eight_bits_gives_nearly_the_same(tmp_path: Path) -> None:
    torch.manual_seed(3)
    network = SfSNet(8, 16, 1)
    network(torch.rand(4, 3, 32, 32))
    for name, small in (("whole", False), ("small", True)):
        save_weights(tmp_path / name, network, {"step": 1}, eight_bit=small)
    assert (tmp_path / "small").stat().st_size < 0.4 * (tmp_path / "whole").stat().st_size
    image = torch.rand(2, 3, 32, 32)
    with torch.no_grad():
        whole, small = (load_weights(tmp_path / name)(image) for name in ("whole", "small"))
    for a, b in zip(whole, small, strict=True):
        # 3.6 % measured: random weights give normals so short that their direction is sensitive. Twice that.
        # What trained networks lose stands on their cards.
        assert float((a - b).abs().mean() / a.abs().mean()) < 0.08
        assert not torch.equal(a, b)


def test_names_are_files_and_other_words_are_not(tmp_path: Path) -> None:
    for name in SHIPPED:
        assert weights_path(name) == weights_path(Path(name))
        assert weights_path(name).name == f"{name}.safetensors"
    assert weights_path(tmp_path / "w.safetensors") == tmp_path / "w.safetensors"
    with pytest.raises(InputError, match=r"'sfsnett' is no file, and no shipped network: .*sfsnet"):
        weights_path("sfsnett")


def test_all_shipped_networks_together_are_small_and_load_by_name() -> None:
    assert sum(weights_path(name).stat().st_size for name in SHIPPED) < 40e6
    for name in SHIPPED:
        trained = load_model(name)
        assert trained.model.architecture == name
        assert trained.crop.size == 64
        assert "/" not in json.dumps(trained.metadata)  # no path of the machine that trained it
        normal = trained.model(torch.rand(1, 3, 64, 64)).normal
        assert bool(torch.isfinite(normal).all())


@pytest.mark.parametrize("name", SHIPPED)
def test_cards_tell_the_stored_numbers(name: str) -> None:
    card = weights_path(name).with_suffix(".md").read_text(encoding="utf-8")
    records = card_records(name)
    assert any(record.what == f"synthetic.normals.mean_deg.{name}" for record in records)
    for record in records:
        assert f"| `{record.what}` | {record.value:.4g} |" in card
    for comparison in compare_with_card(records, records):
        assert comparison.same
    worse = [replace(record, value=1.05 * record.value, interval=None) for record in records]
    assert not any(comparison.same for comparison in compare_with_card(worse, records))


@pytest.mark.slow
def test_shipped_networks_reproduce_their_cards(tmp_path: Path) -> None:
    records = measure_shipped(SHIPPED, tmp_path, "test")
    card = [record for name in SHIPPED for record in card_records(name)]
    assert [str(one) for one in compare_with_card(records, card) if not one.same or one.card is None] == []


def test_networks_are_called_by_file_or_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert weights_name("skipnet-plus") == "skipnet-plus"
    assert weights_name(tmp_path / "mine.safetensors") == "mine"
    run = tmp_path / "first"
    run.mkdir()
    assert weights_name(run / "weights.safetensors") == "first"
    monkeypatch.chdir(run)
    assert weights_name("weights.safetensors") == "first"


def test_two_networks_of_one_name_are_told(tmp_path: Path) -> None:
    """One of them would be measured under the name of both."""
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        save_weights(
            tmp_path / folder / "mine.safetensors", SfSNet(4, 4, 1), {"recipe": {"data": {"size": 32}}}
        )
    names = [tmp_path / folder / "mine.safetensors" for folder in ("a", "b")]
    with pytest.raises(InputError, match=r"names: two networks would be called 'mine'; rename .*mine"):
        measure_shipped(names, tmp_path / "out", "test")
    assert not (tmp_path / "out").exists()
