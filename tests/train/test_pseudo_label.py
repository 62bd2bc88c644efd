"""Labels from a network: kept in few bytes, sure where it agrees with itself, gone on with after a stop."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from data.test_photos import write_photos
from torch import Tensor, nn

from sfsnet_dr.core.conventions import LIGHT_SIZE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.mixed_batch import PseudoLabelOptions
from sfsnet_dr.data.photos import photo_folder
from sfsnet_dr.data.pseudo_labels import decode_labels, encode_labels, load_pseudo_labels
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.data.transforms.mirror import mirror_light, mirror_map, mirror_normal
from sfsnet_dr.models.base import NetworkOutput
from sfsnet_dr.models.sfsnet import SfSNet
from sfsnet_dr.models.weights import save_weights
from sfsnet_dr.render.shading_torch import f_render
from sfsnet_dr.train import pseudo_label as module
from sfsnet_dr.train.config import Recipe
from sfsnet_dr.train.pseudo_label import predict_with_confidence, pseudo_label
from sfsnet_dr.train.sources import configure_sources


class Frank(nn.Module):
    """Answers that follow the picture wherever it goes: what it says of a mirror image is mirrored."""

    def __init__(self, sides: bool = False) -> None:
        super().__init__()
        self.sides = sides

    def forward(self, image: Tensor) -> NetworkOutput:
        slope = image[:, 1:2] - image[:, 1:2].mean((2, 3), keepdim=True)
        x = torch.zeros_like(slope) + (0.5 if self.sides else 0.0)  # the same x for a mirror image is wrong
        normal = torch.cat([x, slope, torch.ones_like(slope)], 1)
        light = image.mean((2, 3)).repeat_interleave(9, dim=1)
        light[:, torch.tensor(odd()).repeat(3)] = 0
        return NetworkOutput(normal / normal.norm(dim=1, keepdim=True), image * 0.5, light)


def odd() -> list[bool]:
    """Which of nine coefficients change sign with x, from the polynomials x, xz and xy."""
    return [name in ("x", "xz", "xy") for name in ["1", "z", "x", "y", "zz", "xz", "yz", "xx-yy", "xy"]]


def smooth() -> Tensor:
    """Two pictures that hardly change from pixel to pixel."""
    ramp = torch.linspace(0.3, 0.5, 32)
    return torch.stack([ramp[:, None].expand(3, 32, 32), (0.6 * ramp)[None, :].expand(3, 32, 32)])


def test_reflected_light_is_the_light_of_the_reflected_face() -> None:
    generator = torch.Generator().manual_seed(0)
    normal = torch.randn(1, 3, 4, 6, generator=generator)
    albedo, light = torch.rand(1, 3, 4, 6), torch.randn(1, LIGHT_SIZE, generator=generator)
    straight = f_render(mirror_normal(normal), mirror_map(albedo), mirror_light(light))
    torch.testing.assert_close(straight, mirror_map(f_render(normal, albedo, light)))
    assert not torch.allclose(
        f_render(mirror_normal(normal), mirror_map(albedo), light),
        mirror_map(f_render(normal, albedo, light)),
    )


def test_answers_that_agree_are_sure() -> None:
    answer, confidence = predict_with_confidence(Frank(), smooth())
    inner = (..., slice(4, -4), slice(4, -4))  # the border is repeated where views move it in
    assert float(confidence[inner].min()) > 0.999
    torch.testing.assert_close(answer.albedo[inner], 0.5 * smooth()[inner], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(answer.normal.norm(dim=1), torch.ones(2, 32, 32))


def test_answers_that_differ_are_not() -> None:
    """The four views say (+-x, 0, z) by halves, atan(0.5) = 26.6 degrees off a mean of length cos 26.6."""
    _, confidence = predict_with_confidence(Frank(sides=True), torch.full((1, 3, 16, 16), 0.4))
    spread = 2 * (1 - 1 / 1.25**0.5)
    torch.testing.assert_close(
        confidence, torch.full_like(confidence, 1 / (1 + spread / module.HALF_ANGLE**2))
    )
    assert float(confidence.max()) < 0.15


def test_what_is_kept_is_rounded_as_promised() -> None:
    generator = torch.Generator().manual_seed(1)
    normal = nn.functional.normalize(torch.randn(3, 3, 16, 16, generator=generator), dim=1)
    albedo = torch.rand(3, 3, 16, 16, generator=generator)
    picture = torch.randint(0, 256, (3, 3, 16, 16), generator=generator).to(torch.uint8)
    confidence = torch.rand(3, 1, 16, 16, generator=generator)
    light = torch.randn(3, LIGHT_SIZE, generator=generator)
    back = decode_labels(encode_labels(picture, picture[:, :1], confidence, normal, albedo, light))
    cosine = (back.normal * normal).sum(1).clamp(-1, 1)
    # Half a step in each of three numbers: sqrt(3) / 254 radians.
    assert float(torch.rad2deg(torch.acos(cosine)).max()) <= 0.40
    # The curve is steepest at white: half a step of the encoded value is 2.3 / 510 there.
    assert float((back.albedo - albedo).abs().max()) <= 0.0045
    torch.testing.assert_close(back.confidence, confidence, rtol=0, atol=0.5 / 255)
    assert torch.equal(back.light, light)
    assert torch.equal(back.image, picture.float() / 255)


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    """A tiny network that says it was trained at 16 x 16."""
    torch.manual_seed(0)
    save_weights(tmp_path / "w.safetensors", SfSNet(4, 4, 1), {"recipe": {"data": {"size": 16}}})
    return tmp_path / "w.safetensors"


def test_a_stopped_run_ends_as_one_that_was_not(
    weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SHARD", 2)
    photos = write_photos(tmp_path / "p", 7)
    (photos / "004.png").write_bytes(b"")
    told = pseudo_label(photo_folder(photos, held_back=1), weights, tmp_path / "whole")
    assert told["labelled"] == 5
    assert list(told["skipped"]) == ["004.png"]
    [held] = told["held_back"]

    def stop(_: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pseudo_label(photo_folder(photos, held_back=1), weights, tmp_path / "cut", on_shard=stop)
    with pytest.raises(InputError, match="no finished labels"):
        load_pseudo_labels(tmp_path / "cut")
    shard = tmp_path / "cut" / "labels-00000.safetensors"
    before = shard.stat().st_mtime_ns
    assert pseudo_label(photo_folder(photos, held_back=1), weights, tmp_path / "cut") == told
    assert shard.stat().st_mtime_ns == before
    whole, cut = (load_pseudo_labels(tmp_path / name) for name in ("whole", "cut"))
    assert whole.fingerprint == cut.fingerprint
    assert whole.names == cut.names
    assert {held, "004.png"}.isdisjoint(whole.names)
    assert tuple(whole.labels.image.shape) == (5, 3, 16, 16)
    assert whole.spec["values"] == "linear"


def test_labels_of_two_kinds_are_not_mixed(weights: Path, tmp_path: Path) -> None:
    photos = write_photos(tmp_path / "p", 2)
    pseudo_label(photo_folder(photos, held_back=0), weights, tmp_path / "out")
    with pytest.raises(InputError, match="labels with size = 16 found, 32 asked for"):
        pseudo_label(photo_folder(photos, held_back=0), weights, tmp_path / "out", size=32)
    shard = tmp_path / "out" / "labels-00000.safetensors"
    shard.write_bytes(shard.read_bytes()[:-1] + b"\1")
    with pytest.raises(InputError, match="missing or changed"):
        load_pseudo_labels(tmp_path / "out")


def test_labels_show_as_much_of_the_frame_as_their_network_saw(tmp_path: Path) -> None:
    torch.manual_seed(0)
    data = {"size": 16, "crop": 96}
    save_weights(tmp_path / "w.safetensors", SfSNet(4, 4, 1), {"recipe": {"data": data}})
    source = photo_folder(write_photos(tmp_path / "p", 2), held_back=0)
    pseudo_label(source, tmp_path / "w.safetensors", tmp_path / "out")
    found = load_pseudo_labels(tmp_path / "out")
    assert found.spec["crop"] == 96
    assert torch.equal(found.labels.mask, source.load(found.names, Crop(16, 96)).masks)
    assert not torch.equal(found.labels.mask, source.load(found.names, Crop(16)).masks)
    recipe = Recipe(
        steps=1, batch_size=4, data=Augmentation(size=16), real=PseudoLabelOptions(batch_fraction=0.5)
    )
    with pytest.raises(InputError, match=r"labels of 96 of .* pixels found, data\.crop 128 is needed"):
        configure_sources(recipe, tmp_path / "out", None, None)
    middle = replace(recipe, data=replace(recipe.data, crop=96))
    assert configure_sources(middle, tmp_path / "out", None, None).counts == (2,)
