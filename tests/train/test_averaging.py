"""Means of networks: of every tensor, by shares, and of one kind of network only."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from sfsnet_dr.cli.main import main
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.provenance import sha256
from sfsnet_dr.models.sfsnet import SfSNet
from sfsnet_dr.models.weights import load_weights, read_metadata, save_weights
from sfsnet_dr.train.averaging import average_weights

RECIPE = {"recipe": {"data": {"size": 64, "crop": 96}}}


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """Two small networks with statistics of their own."""
    paths = []
    for seed in (1, 2):
        torch.manual_seed(seed)
        network = SfSNet(4, 8, 1)
        network(torch.rand(2, 3, 16, 16))
        paths.append(tmp_path / f"{seed}.safetensors")
        save_weights(paths[-1], network, RECIPE | {"step": seed})
    return paths


def test_every_tensor_is_the_mean_by_shares(files: list[Path]) -> None:
    first, second = (load_weights(path).state_dict() for path in files)
    found = average_weights(files, (1, 3))
    assert not found.training
    for name, tensor in found.state_dict().items():
        if tensor.is_floating_point():
            # One rounding to float32, of values near 1.
            torch.testing.assert_close(tensor, 0.25 * first[name] + 0.75 * second[name], rtol=1e-6, atol=1e-7)
        else:
            assert torch.equal(tensor, second[name])


def test_equal_shares_are_the_default_and_units_do_not_matter(files: list[Path]) -> None:
    one, other = average_weights(files).state_dict(), average_weights(files, (5, 5)).state_dict()
    assert all(torch.equal(one[name], other[name]) for name in one)


def test_the_command_tells_what_the_mean_is_of(files: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "mean.safetensors"
    assert main(["weights", "average", *map(str, files), "--coefficients", "3", "7", "--out", str(out)]) == 0
    told = read_metadata(out)
    assert told["mean_of"] == [
        {"sha256": sha256(files[0]), "share": 3.0},
        {"sha256": sha256(files[1]), "share": 7.0},
    ]
    assert told["step"] == 2
    expected = average_weights(files, (0.3, 0.7)).state_dict()
    for name, tensor in load_weights(out).state_dict().items():
        torch.testing.assert_close(tensor, expected[name], rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(
    ("shares", "told"),
    [
        ((1, 2, 3), "3 found for 2 files"),
        ((1, 0), "above 0 are allowed"),
        ((1, float("nan")), "finite numbers"),
    ],
)
def test_shares_that_do_not_fit_are_refused(files: list[Path], shares: tuple[float, ...], told: str) -> None:
    with pytest.raises(InputError, match=told):
        average_weights(files, shares)


def test_one_network_and_networks_of_two_kinds_are_refused(files: list[Path], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="two files at least"):
        average_weights(files[:1])
    save_weights(tmp_path / "wide.safetensors", SfSNet(8, 8, 1), RECIPE)
    save_weights(tmp_path / "whole.safetensors", SfSNet(4, 8, 1))
    for name in ("wide", "whole"):
        with pytest.raises(InputError, match=f"{name}.*only networks of one kind"):
            average_weights([files[0], tmp_path / f"{name}.safetensors"])
