"""Weights files: they bring back the same network, and anything else is refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.models.base import Network
from sfsnet_dr.models.sfsnet import SfSNet
from sfsnet_dr.models.skipnet import SkipNet, SkipNetPlus
from sfsnet_dr.models.weights import (
    HEADER,
    build_network,
    load_weights,
    network_settings,
    read_metadata,
    save_weights,
)


@pytest.fixture
def model() -> SfSNet:
    """A small network whose running statistics are not the initial ones."""
    torch.manual_seed(3)
    network = SfSNet(4, 8, 1)
    network(torch.rand(2, 3, 16, 16))
    return network


def test_a_loaded_network_gives_the_same_numbers(tmp_path: Path, model: SfSNet) -> None:
    save_weights(tmp_path / "w.safetensors", model, {"step": 7})
    loaded = load_weights(tmp_path / "w.safetensors")
    images = torch.rand(2, 3, 16, 16)
    assert not loaded.training
    with torch.no_grad():
        for a, b in zip(model.eval()(images), loaded(images), strict=True):
            assert torch.equal(a, b)
    assert read_metadata(tmp_path / "w.safetensors") == {"step": 7}


def test_the_same_network_gives_the_same_bytes(tmp_path: Path, model: SfSNet) -> None:
    for name in "ab":
        save_weights(tmp_path / name, model, {"b": 1, "a": [2]})
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def refused(path: Path, *words: str) -> None:
    with pytest.raises(InputError) as caught:
        load_weights(path)
    message = str(caught.value)
    assert "\n" not in message
    for word in (str(path), *words):
        assert word in message


def test_other_files_are_refused(tmp_path: Path, model: SfSNet) -> None:
    refused(tmp_path / "absent.safetensors", "no such file")

    text = tmp_path / "text.safetensors"
    text.write_text("hello")
    refused(text, "not a safetensors file")

    foreign = tmp_path / "foreign.safetensors"
    save_file({"x": torch.zeros(1)}, foreign)
    refused(foreign, "no format name", "sfsnet_dr.weights")

    whole = tmp_path / "whole.safetensors"
    save_weights(whole, model)
    cut = tmp_path / "cut.safetensors"
    cut.write_bytes(whole.read_bytes()[:-100])
    refused(cut, "not a safetensors file")


def rewritten(path: Path, model: SfSNet, old: str, new: str) -> Path:
    """A weights file whose header is changed in one place."""
    from safetensors import safe_open

    save_weights(path, model)
    with safe_open(path, framework="pt") as file:
        header = file.metadata()[HEADER]
    assert old in header
    save_file(
        {k: v.contiguous() for k, v in model.state_dict().items()}, path, {HEADER: header.replace(old, new)}
    )
    return path


def test_another_architecture_or_version_is_named(tmp_path: Path, model: SfSNet) -> None:
    path = tmp_path / "w.safetensors"
    refused(rewritten(path, model, '"sfsnet"', '"sfsnat"'), "'sfsnat'", "did you mean 'sfsnet'?")
    refused(rewritten(path, model, '"version": 1', '"version": 9'), "version 9", "1 expected")
    refused(rewritten(path, model, '"stem": 4', '"stem": 5'), "has shape (4, 3, 7, 7)", "(5, 3, 7, 7)")
    refused(rewritten(path, model, '"blocks": 1', '"blocks": 2'), "does not hold the network")
    refused(rewritten(path, model, '"stem"', '"stemm"'), "'stemm'", "did you mean 'stem'?")


def test_nothing_is_left_when_the_folder_is_missing(tmp_path: Path, model: SfSNet) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        save_weights(tmp_path / "nowhere" / "w.safetensors", model)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("network", [SkipNet(4, 32), SkipNetPlus(4)], ids=["skipnet", "skipnet-plus"])
def test_every_architecture_comes_back_by_its_name(tmp_path: Path, network: Network) -> None:
    images = torch.rand(2, 3, 32, 32)
    network(images)
    save_weights(tmp_path / "w.safetensors", network)
    loaded = load_weights(tmp_path / "w.safetensors")
    assert type(loaded) is type(network)
    assert loaded.config == network.config
    with torch.no_grad():
        for a, b in zip(network.eval()(images), loaded(images), strict=True):
            assert torch.equal(a, b)


def test_settings_are_those_of_the_paper() -> None:
    assert network_settings("skipnet") == {"width": 64, "size": 128}
    assert network_settings("skipnet-plus") == {"width": 64}
    with pytest.raises(InputError, match="'skipnet-plsu' found; did you mean 'skipnet-plus'"):
        network_settings("skipnet-plsu")


def test_sizes_below_one_are_refused() -> None:
    with pytest.raises(InputError, match="blocks: 0"):
        build_network("sfsnet", {"blocks": 0})
