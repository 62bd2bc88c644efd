"""Running a network on images, without gradients."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from sfsnet_dr.model.outputs import Decomposition


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
