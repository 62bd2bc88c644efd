"""Answers without gradients: the same in any batches, and asked both ways they reflect with the image."""

from __future__ import annotations

import pytest
import torch

from sfsnet_dr.data.transforms.mirror import mirror_light, mirror_map, mirror_normal
from sfsnet_dr.models.base import NetworkOutput
from sfsnet_dr.models.inference import predict, predict_with_flip_tta
from sfsnet_dr.models.sfsnet import SfSNet


@pytest.fixture(scope="module")
def network() -> SfSNet:
    torch.manual_seed(0)
    return SfSNet(4, 8, 1)


IMAGES = torch.rand(3, 3, 16, 16, generator=torch.Generator().manual_seed(1))


def furthest(a: NetworkOutput, b: NetworkOutput) -> float:
    return max(float((x - y).abs().max()) for x, y in zip(a, b, strict=True))


def test_batches_do_not_matter_and_the_mode_comes_back(network: SfSNet) -> None:
    network.train()
    assert furthest(predict(network, IMAGES, 2), predict(network, IMAGES, 3)) < 1e-5  # float32 sums
    assert network.training


def test_asked_both_ways_a_mirrored_face_has_the_mirrored_answer(network: SfSNet) -> None:
    straight, mirrored = (predict_with_flip_tta(network, images) for images in (IMAGES, mirror_map(IMAGES)))
    back = NetworkOutput(
        mirror_normal(mirrored.normal), mirror_map(mirrored.albedo), mirror_light(mirrored.light)
    )
    assert furthest(straight, back) < 1e-5
    once = [predict(network, images) for images in (IMAGES, mirror_map(IMAGES))]
    assert (
        float((once[0].normal - mirror_normal(once[1].normal)).abs().max()) > 0.01
    )  # or it would show nothing
    # What both answers share is kept.
    mean = (once[0].albedo + mirror_map(once[1].albedo)) / 2
    assert torch.equal(straight.albedo, mean)
    torch.testing.assert_close(straight.normal.square().sum(1), torch.ones(3, 16, 16))
