"""Running a network on images, without gradients."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from sfsnet_dr.data.flip import flip_light, flip_map, flip_normal
from sfsnet_dr.model.outputs import Decomposition
from sfsnet_dr.render.shading_torch import unit


@torch.no_grad()
def predict(model: nn.Module, images: Tensor, batch_size: int = 16) -> Decomposition:
    """Decompose images with the running statistics of batch normalisation, in float32.

    The model's training mode is put back afterwards.

    Args:
        model: a network with the interface of ``SfSNet``.
        images: linear Rec. 709, (B, 3, H, W), on the model's device.
        batch_size: images that are computed at once; bounds memory, does not change the result.
    """
    training = model.training
    model.eval()
    try:
        parts = [model(chunk) for chunk in torch.split(images, batch_size)]
    finally:
        model.train(training)
    return Decomposition(*(torch.cat(tensors) for tensors in zip(*parts, strict=True)))


def predict_both_ways(model: nn.Module, images: Tensor, batch_size: int = 16) -> Decomposition:
    """The mean of the answers to images and to their mirror images; takes twice as long as ``predict``.

    What a network says of a reflected face should be the reflection of what it says of the face. Where it is
    not, the mean is nearer to the truth: README, "Real faces", tells by how much.
    """
    straight = predict(model, images, batch_size)
    back = mirrored(predict(model, flip_map(images), batch_size))
    return Decomposition(
        unit(straight.normal + back.normal),
        (straight.albedo + back.albedo) / 2,
        (straight.light + back.light) / 2,
    )


def mirrored(answer: Decomposition) -> Decomposition:
    """The left-right reflection of an answer."""
    return Decomposition(flip_normal(answer.normal), flip_map(answer.albedo), flip_light(answer.light))
