"""Stage two of the paper's training: a network's answers for photographs become labels for another network.

A label is the mean of the answers to four views of a photograph (itself, its mirror image, both shifted by a
few pixels), brought back to its frame. Where the answers disagree the network guesses, and nothing tells that
without ground truth better: with a the RMS angle of the normals to their mean, and d the RMS deviation of the
albedo relative to its mean plus 0.05, a pixel's confidence is

    1 / (1 + (a / 10 degrees)^2)  *  1 / (1 + (d / 0.1)^2).

It is blind to errors that all views share. Light is weighted by its face's mean confidence (``loss.terms``).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from sfsnet_dr.core.conventions import FACE_SIZE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import output_dir
from sfsnet_dr.core.provenance import sha256
from sfsnet_dr.data.photos import PhotoSet, PhotoSource
from sfsnet_dr.data.pseudo_labels import SHARD, Encoding, LabelFolder, Labels, as_network_input, encode_labels
from sfsnet_dr.data.transforms.mirror import mirror_map
from sfsnet_dr.models.base import NetworkOutput
from sfsnet_dr.models.inference import load_model, mirror_output, predict
from sfsnet_dr.models.shipped import weights_path

#: Deviations at which a pixel's confidence has fallen to a half.
HALF_ANGLE: Final = math.radians(10)
HALF_ALBEDO: Final = 0.1
#: Shift of the jittered views, of the picture's width: 3 of 128 pixels.
_SHIFT: Final = 3 / 128


def pseudo_label(
    photographs: PhotoSource,
    weights: Path | str,
    out: Path | str,
    *,
    size: int | None = None,
    values: Encoding | None = None,
    on_shard: Callable[[int], object] = lambda _: None,
) -> dict[str, Any]:
    """Label photographs; a stopped run is continued.

    Args:
        photographs: of ``data.photo_source``; those held back are listed in the manifest and get no labels.
        weights: of the network that answers.
        out: folder for the labels; made if missing.
        size: width and height; the size that the weights were trained at if not given.
        values: what a photograph's numbers are to the network, if not what its recipe says.
        on_shard: called with the number of photographs that a shard took.

    Returns:
        The manifest: ``labelled`` (their number), ``held_back`` (names), ``skipped`` (reasons by name).

    Raises:
        InputError: for unusable photographs or weights, or an ``out`` with other labels.
    """
    train = photographs.train
    trained = load_model(weights)
    view = trained.crop._replace(size=size or trained.crop.size)
    spec: dict[str, Any] = {
        "weights": sha256(weights_path(weights)),
        "size": view.size,
        **({"crop": view.crop} if view.crop < FACE_SIZE else {}),
        "values": values or trained.encoding,
        "photographs": photographs.fingerprint,
    }
    folder = LabelFolder(output_dir(out), spec)
    shards = [train[begin : begin + SHARD] for begin in range(0, len(train), SHARD)]
    for number, shard in enumerate(shards):
        if not folder.has(number):
            read = photographs.load(shard, view)
            reasons = {item.name: item.reason for item in read.skipped}
            folder.write(
                number,
                label_photographs(trained.model, read, spec["values"]),
                read.names,
                read.hashes,
                reasons,
            )
        on_shard(len(shard))
    return folder.finish(len(shards), photographs.held, photographs.skipped)


def label_photographs(model: nn.Module, photographs: PhotoSet, values: Encoding = "linear") -> Labels:
    """Label photographs in memory."""
    if not len(photographs):
        raise InputError("photographs: none of a whole shard can be read; see whether their files are whole")
    image = as_network_input(photographs.images, values)
    answer, confidence = predict_with_confidence(model, image)
    return encode_labels(photographs.images, photographs.masks, confidence, *answer)


def predict_with_confidence(model: nn.Module, image: Tensor) -> tuple[NetworkOutput, Tensor]:
    """The mean answer to four views of images (N, 3, S, S), and its confidence (N, 1, S, S) in [0, 1]."""
    step = max(1, round(_SHIFT * image.shape[-1]))
    answers = [
        _answer(model, image, flip, shift)
        for flip, shift in ((False, (0, 0)), (True, (0, 0)), (False, (step, -step)), (True, (step, step)))
    ]
    normal, albedo, light = (torch.stack(parts) for parts in zip(*answers, strict=True))
    direction = normal.mean(0)
    length = direction.square().sum(1, keepdim=True).sqrt()
    # The mean squared distance of unit vectors to their mean direction is 2 (1 - |mean|).
    angle = 2 * (1 - length).clamp_min(0) / HALF_ANGLE**2
    mean = albedo.mean(0)
    deviation = (albedo - mean).square().mean((0, 2))[:, None].sqrt() / (
        mean.mean(1, keepdim=True).abs() + 0.05
    )
    confidence = 1 / (1 + angle) / (1 + (deviation / HALF_ALBEDO).square())
    return NetworkOutput(direction / length.clamp_min(1e-6), mean, light.mean(0)), confidence


def _answer(model: nn.Module, image: Tensor, flip: bool, shift: tuple[int, int]) -> NetworkOutput:
    """The answer to a view, in the frame of the image itself."""
    view = _shifted(mirror_map(image) if flip else image, shift)
    normal, albedo, light = predict(model, view)
    back = (-shift[0], -shift[1])
    answer = NetworkOutput(_shifted(normal, back), _shifted(albedo, back), light)
    return mirror_output(answer) if flip else answer


def _shifted(image: Tensor, shift: tuple[int, int]) -> Tensor:
    """Moved by whole pixels to the right and down; the border is repeated where nothing moves in."""
    x, y = shift
    if not (x or y):
        return image
    border = max(abs(x), abs(y))
    height, width = image.shape[-2:]
    padded = functional.pad(image, (border,) * 4, mode="replicate")
    return padded[..., border - y : border - y + height, border - x : border - x + width]
