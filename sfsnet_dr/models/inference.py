"""Load a trained network with its crop and encoding, and run it without gradients."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from sfsnet_dr.core.conventions import FACE_SIZE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.pseudo_labels import Encoding
from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.data.transforms.mirror import mirror_light, mirror_map, mirror_normal
from sfsnet_dr.models.base import Network, NetworkOutput
from sfsnet_dr.models.shipped import BEST
from sfsnet_dr.models.weights import load_weights, read_metadata
from sfsnet_dr.render.shading_torch import unit


@torch.no_grad()
def predict(model: nn.Module, images: Tensor, batch_size: int = 16) -> NetworkOutput:
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
    return NetworkOutput(*(torch.cat(tensors) for tensors in zip(*parts, strict=True)))


def predict_with_flip_tta(model: nn.Module, images: Tensor, batch_size: int = 16) -> NetworkOutput:
    """The mean of the answers to images and to their mirror images; takes twice as long as ``predict``.

    What a network says of a reflected face should be the reflection of what it says of the face. Where it is
    not, the mean is nearer to the truth: README, "Real faces", tells by how much.
    """
    straight = predict(model, images, batch_size)
    back = mirror_output(predict(model, mirror_map(images), batch_size))
    return NetworkOutput(
        unit(straight.normal + back.normal),
        (straight.albedo + back.albedo) / 2,
        (straight.light + back.light) / 2,
    )


def mirror_output(answer: NetworkOutput) -> NetworkOutput:
    """The left-right reflection of an answer."""
    return NetworkOutput(mirror_normal(answer.normal), mirror_map(answer.albedo), mirror_light(answer.light))


@dataclass(frozen=True, eq=False)
class LoadedModel:
    """A network as ``sfsnet-dr train`` left it.

    Attributes:
        model: in evaluation mode.
        crop: what it was shown of the frame, and with how many pixels; it answers best for that, and some
            networks at no other size.
        encoding: what a photograph's numbers are to it.
        metadata: everything that its file says.
    """

    model: Network
    crop: Crop
    encoding: Encoding
    metadata: dict[str, Any]


def load_model(weights: Path | str = BEST, *, device: torch.device | str = "cpu") -> LoadedModel:
    """Load a trained network, in evaluation mode.

    Args:
        weights: name of a network in the package (``sfsnet-dr weights list``), or a file that training wrote.
            A file without a recipe counts as trained on linear images of 128 x 128.
        device: where the network computes.

    Returns:
        The network (``.model``, a ``torch.nn.Module``) with the crop and the encoding it was trained on.

    Raises:
        InputError: for an unknown name, or unusable weights.

    Example:
        >>> import sfsnet_dr as sf
        >>> sf.load_model("skipnet").model.architecture
        'skipnet'
    """
    metadata = read_metadata(weights)
    recipe = metadata.get("recipe", {})
    data = recipe.get("data", {})
    view = Crop(int(data.get("size") or FACE_SIZE), int(data.get("crop") or FACE_SIZE))
    if not 1 <= view.size <= view.crop <= FACE_SIZE:
        raise InputError(
            f"{weights}: trained on {view.crop} of the frame's {FACE_SIZE} pixels shown with {view.size}, no "
            "more pixels than are shown are needed"
        )
    network = load_weights(weights).to(device)
    return LoadedModel(network, view, recipe.get("real", {}).get("values", "linear"), metadata)
