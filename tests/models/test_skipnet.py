"""Layers, shapes and parameter counts of SkipNet and SkipNet+ against the appendix, worked out by hand."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.models.base import Network
from sfsnet_dr.models.skipnet import Decoder, SkipNet, SkipNetPlus


def convolution(inputs: int, outputs: int, kernel: int) -> int:
    """Parameters of a convolution or deconvolution with bias."""
    return inputs * outputs * kernel * kernel + outputs


def batch_norm(features: int) -> int:
    """Scale and shift."""
    return 2 * features


def connected(inputs: int, outputs: int) -> int:
    """Parameters of a fully connected layer."""
    return inputs * outputs + outputs


def decoder() -> int:
    """CD256 - CD256 - CD256 - CD128 - CD64 - C*3(k1), a response of the encoder joined to each input."""
    total = 0
    for inputs, skipped, outputs in ((256, 256, 256), (256, 256, 256), (256, 256, 256), (256, 128, 128),
                                     (128, 64, 64)):  # fmt: skip
        total += convolution(inputs + skipped, outputs, 4) + batch_norm(outputs)
    return total + convolution(64, 3, 1)


def count(network: nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def test_skipnet_has_the_parameters_of_the_appendix() -> None:
    # C*64(k4) - C128(k4) - C256(k4) - C256(k4) - C256(k4) - fc256, the first without batch normalisation
    encoder = convolution(3, 64, 4) + convolution(64, 128, 4) + batch_norm(128)
    encoder += convolution(128, 256, 4) + 2 * convolution(256, 256, 4) + 3 * batch_norm(256)
    encoder += connected(256 * 4 * 4, 256)
    mlp, light = connected(256, 3 * 256), connected(256, 27)
    assert (encoder, mlp, light, decoder()) == (3_807_168, 197_376, 6_939, 7_277_571)
    assert count(SkipNet()) == encoder + mlp + light + 2 * decoder() == 18_566_625


def test_skipnet_plus_has_the_parameters_of_the_appendix() -> None:
    # Co64(k3) - Co64(k1) - C64(k3) - Co64(k1) - C128(k3) - Co128(k1) - C256(k3) - Co256(k1) - C256(k3) -
    # Co256(k1) - C256(k3), each with batch normalisation
    layers = ((3, 64, 3), (64, 64, 1), (64, 64, 3), (64, 64, 1), (64, 128, 3), (128, 128, 1), (128, 256, 3),
              (256, 256, 1), (256, 256, 3), (256, 256, 1), (256, 256, 3))  # fmt: skip
    encoder = sum(convolution(*layer) + batch_norm(layer[1]) for layer in layers)
    entry, light = convolution(256, 256, 1) + batch_norm(256), connected(256, 27)
    assert (encoder, entry, light) == (1_747_904, 66_304, 6_939)
    assert count(SkipNetPlus()) == encoder + light + 2 * (entry + decoder()) == 16_442_593


def layer_names(module: nn.Module) -> list[str]:
    """Leaf layers in order; C for convolutions, CD for deconvolutions, F for fully connected ones."""
    names = []
    for layer in module.modules():
        if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d):
            kind = "CD" if isinstance(layer, nn.ConvTranspose2d) else "C"
            names.append(f"{kind}{layer.out_channels}k{layer.kernel_size[0]}s{layer.stride[0]}")
        elif isinstance(layer, nn.Linear):
            names.append(f"F{layer.out_features}")
        elif isinstance(layer, nn.LeakyReLU):
            names.append(f"R{layer.negative_slope:g}")
        elif isinstance(layer, nn.BatchNorm2d):
            names.append("B")
    return names


def followed(*convolutions: str, relu: str) -> list[str]:
    """Convolutions with batch normalisation and ReLU after each."""
    return [name for layer in convolutions for name in (layer, "B", relu)]


def test_layers_stand_in_the_order_of_the_appendix() -> None:
    model = SkipNet()
    wide = followed("C128k4s2", "C256k4s2", "C256k4s2", "C256k4s2", relu="R0.2")
    assert layer_names(model.encoder) == ["C64k4s2", "R0.2", *wide]
    assert layer_names(model.bottleneck)[0] == "F256"
    assert layer_names(model.mlp)[0] == "F768"
    assert layer_names(model.light_out) == ["F27"]
    up = ("CD256k4s2", "CD256k4s2", "CD256k4s2", "CD128k4s2", "CD64k4s2")
    for part in (model.normal_decoder, model.albedo_decoder):
        assert layer_names(part) == [*followed(*up, relu="R0.2"), "C3k1s1"]

    plus = SkipNetPlus()
    down = ("C64k3s1", "C64k1s1", "C64k3s2", "C64k1s1", "C128k3s2", "C128k1s1", "C256k3s2", "C256k1s1",
            "C256k3s2", "C256k1s1", "C256k3s2")  # fmt: skip
    assert layer_names(plus.entry) + layer_names(plus.encoder) == followed(*down, relu="R0.3")
    assert (
        layer_names(plus.normal_entry) == layer_names(plus.albedo_entry) == followed("C256k1s1", relu="R0.3")
    )
    for part in (plus.normal_decoder, plus.albedo_decoder):
        assert layer_names(part) == [*followed(*up, relu="R0.3"), "C3k1s1"]


#: Responses of 128 x 128 images from the outermost, as the appendix gives them.
RESPONSES = [(1, 64, 64, 64), (1, 128, 32, 32), (1, 256, 16, 16), (1, 256, 8, 8), (1, 256, 4, 4)]


@pytest.mark.parametrize("make", [SkipNet, SkipNetPlus])
def test_every_stage_has_the_shape_of_the_appendix(make: Callable[[], Network]) -> None:
    model = make().eval()
    encoded: list[tuple[int, ...]] = []
    decoded: list[tuple[int, ...]] = []
    inputs: list[tuple[int, ...]] = []
    for layer in model.get_submodule("encoder").children():
        layer.register_forward_hook(lambda _m, _i, out: encoded.append(tuple(out.shape)))
    for layer in model.get_submodule("normal_decoder.layers").children():
        layer.register_forward_hook(lambda _m, _i, out: decoded.append(tuple(out.shape)))
        layer.register_forward_pre_hook(lambda _m, given: inputs.append(tuple(given[0].shape)))
    with torch.no_grad():
        result = model(torch.rand(1, 3, 128, 128))
    assert encoded == RESPONSES
    assert inputs == [(1, 512, 4, 4), (1, 512, 8, 8), (1, 512, 16, 16), (1, 384, 32, 32), (1, 192, 64, 64)]
    assert decoded == [
        (1, 256, 8, 8),
        (1, 256, 16, 16),
        (1, 256, 32, 32),
        (1, 128, 64, 64),
        (1, 64, 128, 128),
    ]
    assert [tuple(t.shape) for t in result] == [(1, 3, 128, 128), (1, 3, 128, 128), (1, 27)]
    torch.testing.assert_close(result.normal.norm(dim=1), torch.ones(1, 128, 128), atol=1e-6, rtol=0)


def test_skip_connections_carry_what_the_rest_does_not() -> None:
    """With the innermost input held, the map still follows each response of the encoder."""
    model = Decoder(16, (4, 8, 16, 16, 16), 0.2).eval()
    inner = torch.rand(1, 16, 1, 1)
    responses = [torch.rand(1, c, 16 >> i, 16 >> i) for i, c in enumerate((4, 8, 16, 16, 16))]
    before = model(inner, responses)
    for index in range(5):
        changed = [r + 1 if i == index else r for i, r in enumerate(responses)]
        assert not torch.allclose(model(inner, changed), before)


@pytest.mark.parametrize("model", [SkipNet(4, 32), SkipNetPlus(4)], ids=["skipnet", "skipnet-plus"])
def test_all_weights_of_each_answer_learn(model: Network) -> None:
    image = torch.rand(2, 3, 64, 64) if isinstance(model, SkipNetPlus) else torch.rand(2, 3, 32, 32)
    energy: Tensor = sum((part.square().sum() for part in model(image)[1:]), model(image).normal[:, 0].sum())
    energy.backward()  # type: ignore[no-untyped-call]
    assert all(p.grad is not None and torch.isfinite(p.grad).all() for p in model.parameters())
    parameters = list(model.parameters())
    assert len({parameter.data_ptr() for parameter in parameters}) == len(parameters)


def test_skipnets_light_comes_from_the_bottleneck_alone() -> None:
    model = SkipNet(4, 32).eval()
    model(torch.rand(2, 3, 32, 32)).light.square().sum().backward()
    assert all(p.grad is None for p in model.normal_decoder.parameters())
    assert all(p.grad is not None for p in model.encoder.parameters())


def test_images_of_another_size_are_refused() -> None:
    with pytest.raises(InputError, match="48 x 32 pixels found, multiples of 32"):
        SkipNetPlus(4)(torch.rand(1, 3, 48, 32))
    with pytest.raises(
        InputError, match=r"64 x 64 pixels found, this skipnet was made for 32 x 32; set data\.size"
    ):
        SkipNet(4, 32)(torch.rand(1, 3, 64, 64))
    with pytest.raises(InputError, match="size: 48 found, a multiple of 32"):
        SkipNet(4, 48)
    with pytest.raises(InputError, match="width: 0 found"):
        SkipNetPlus(0)
