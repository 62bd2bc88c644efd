"""Layers, shapes and parameter count of SfSNet against numbers worked out by hand from the appendix."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.models.inference import predict
from sfsnet_dr.models.layers import MapHead, to_map, unit_normal
from sfsnet_dr.models.sfsnet import SfSNet


def convolution(inputs: int, outputs: int, kernel: int) -> int:
    """Parameters of a convolution with bias."""
    return inputs * outputs * kernel * kernel + outputs


def batch_norm(features: int) -> int:
    """Scale and shift."""
    return 2 * features


def test_parameter_count_is_that_of_the_appendix() -> None:
    # Conv: C64(k7) - C128(k3) - C*128(k3)
    stem = convolution(3, 64, 7) + batch_norm(64) + convolution(64, 128, 3) + batch_norm(128)
    stem += convolution(128, 128, 3)
    # 5 ResBLK - BN - ReLU, where ResBLK is BN - ReLU - C128 - BN - ReLU - C128
    branch = 5 * 2 * (batch_norm(128) + convolution(128, 128, 3)) + batch_norm(128)
    # BU - C128(k1) - C64(k3) - C*3(k1); bilinear up-sampling has no parameters
    head = convolution(128, 128, 1) + batch_norm(128) + convolution(128, 64, 3) + batch_norm(64)
    head += convolution(64, 3, 1)
    # concatenation - C128(k1) - average - fully connected 27
    light = convolution(384, 128, 1) + batch_norm(128) + (128 * 27 + 27)
    assert (stem, branch, head, light) == (231_296, 1_478_656, 90_883, 53_019)

    model = SfSNet()
    counted = sum(parameter.numel() for parameter in model.parameters())
    assert counted == stem + 2 * branch + 2 * head + light == 3_423_393


def test_every_stage_has_the_shape_of_the_appendix() -> None:
    model = SfSNet().eval()
    seen: dict[str, tuple[int, ...]] = {}
    for name, module in model.named_children():
        module.register_forward_hook(lambda _m, _i, out, name=name: seen.update({name: tuple(out.shape)}))
    with torch.no_grad():
        result = model(torch.rand(1, 3, 128, 128))
    assert seen == {
        "conv": (1, 128, 64, 64),
        "normal_blocks": (1, 128, 64, 64),
        "albedo_blocks": (1, 128, 64, 64),
        "normal_head": (1, 3, 128, 128),
        "albedo_head": (1, 3, 128, 128),
        "light_features": (1, 128, 64, 64),
        "light_out": (1, 27),
    }
    assert [tuple(t.shape) for t in result] == [(1, 3, 128, 128), (1, 3, 128, 128), (1, 27)]
    torch.testing.assert_close(result.normal.norm(dim=1), torch.ones(1, 128, 128), atol=1e-6, rtol=0)


def layer_names(module: nn.Module) -> list[str]:
    """Leaf layers in order, convolutions with their sizes."""
    names = []
    for layer in module.modules():
        if isinstance(layer, nn.Conv2d):
            names.append(f"C{layer.out_channels}k{layer.kernel_size[0]}s{layer.stride[0]}")
        elif not list(layer.children()):
            names.append(type(layer).__name__)
    return names


def test_layers_stand_in_the_order_of_the_appendix() -> None:
    model = SfSNet()
    after = ["BatchNorm2d", "ReLU"]
    assert layer_names(model.conv) == ["C64k7s1", *after, "C128k3s1", *after, "C128k3s2"]
    block = [*after, "C128k3s1", *after, "C128k3s1"]
    assert layer_names(model.normal_blocks) == layer_names(model.albedo_blocks) == [*(block * 5), *after]
    assert layer_names(model.normal_head) == ["C128k1s1", *after, "C64k3s1", *after, "C3k1s1"]
    assert layer_names(model.light_features) == ["C128k1s1", *after]


@pytest.mark.parametrize("training", [True, False])
def test_a_head_is_that_of_the_appendix_though_it_interpolates_later(training: bool) -> None:
    torch.manual_seed(0)
    head = MapHead(8, 4).double().train(training)
    head.out.float()
    x = torch.randn(2, 8, 6, 10, dtype=torch.float64)
    raised = nn.functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
    expected = to_map(head.layers(raised), head.out)
    # the head's last layer works in float32; features of about 1
    torch.testing.assert_close(head(x), expected, atol=1e-5, rtol=0)


def test_the_two_branches_share_no_weights() -> None:
    parameters = list(SfSNet(4, 8, 1).parameters())
    assert len({parameter.data_ptr() for parameter in parameters}) == len(parameters)


def test_residual_blocks_pass_features_through_unchanged_when_their_layers_are_zero() -> None:
    model = SfSNet(4, 8, 2)
    block = model.normal_blocks[0]
    for parameter in block.parameters():
        nn.init.zeros_(parameter)
    features = torch.randn(2, 8, 6, 6)
    torch.testing.assert_close(block(features), features, atol=0, rtol=0)


def test_light_sees_image_normal_and_albedo_features() -> None:
    model = SfSNet(4, 8, 1)
    energy: Tensor = model(torch.rand(2, 3, 16, 16)).light.square().sum()
    energy.backward()  # type: ignore[no-untyped-call]
    for part in (model.conv, model.normal_blocks, model.albedo_blocks):
        assert all(p.grad is not None and torch.isfinite(p.grad).all() for p in part.parameters())
        assert sum(float(p.grad.abs().sum()) for p in part.parameters() if p.grad is not None) > 0
    assert all(p.grad is None for p in model.normal_head.parameters())


def test_the_gradient_of_a_vanishing_normal_is_bounded() -> None:
    raw = torch.zeros(1, 3, 1, 1, requires_grad=True)
    unit_normal(raw).sum().backward()  # type: ignore[no-untyped-call]
    assert raw.grad is not None
    # 1 / SHORTEST_NORMAL = 100 for each of the three components
    torch.testing.assert_close(raw.grad, torch.full_like(raw, 100.0))


def test_predict_does_not_depend_on_the_split_into_batches() -> None:
    torch.manual_seed(1)
    model = SfSNet(4, 8, 1).train()
    images = torch.rand(5, 3, 16, 16)
    whole, split = predict(model, images), predict(model, images, batch_size=2)
    assert model.training
    for a, b in zip(whole, split, strict=True):
        # float32 sums taken in another order, divided by short normals: worst seen 8e-6
        torch.testing.assert_close(a, b, atol=5e-5, rtol=0)
    assert not whole.normal.requires_grad


@pytest.mark.parametrize("shape", [(3, 16, 16), (1, 4, 16, 16), (1, 3, 15, 16)])
def test_images_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="image"):
        SfSNet(4, 8, 1)(torch.rand(shape))
