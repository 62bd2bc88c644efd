"""A picture of what a network makes of a batch, to look at while it trains."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import torch
from torch import Tensor, nn

from sfsnet_dr.base.color_torch import linear_to_srgb
from sfsnet_dr.base.imageio import write_png
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.mixture import MixedBatch
from sfsnet_dr.data.pseudo_labels import Values
from sfsnet_dr.model.outputs import Decomposition
from sfsnet_dr.model.predict import predict
from sfsnet_dr.render.shading_torch import f_render, shading

#: Faces of each kind, at most.
ROWS: Final = 4


def write_pictures(path: Path, model: nn.Module, batch: FaceBatch | MixedBatch, values: Values) -> None:
    """Write a PNG with a row for each face: image, normals, albedo, shading and product; then the labels'.

    Rendered faces come first, photographs with their pseudo-labels after them. The network answers as it
    would after training: with the running statistics of batch normalisation.
    """
    kinds = [batch] if isinstance(batch, FaceBatch) else [batch.labelled, batch.real.faces]
    rows = []
    for kind in kinds:
        kind = FaceBatch(*(part[:ROWS] for part in kind))
        answer = predict(model, kind.image)
        labels = _columns(Decomposition(kind.normal, kind.albedo, kind.light), kind.mask, values)
        shown = [_shown(kind.image, values), *_columns(answer, kind.mask, values), *labels]
        rows.append(torch.cat(shown, dim=3))
    grid = torch.cat([row for kind in rows for row in kind], dim=1)
    write_png(path, grid.permute(1, 2, 0).cpu().numpy(), encoded=True)


def _columns(answer: Decomposition, mask: Tensor, values: Values) -> list[Tensor]:
    shade = shading(answer.normal, answer.light)
    peak = (shade * mask).amax((1, 2, 3), keepdim=True).clamp_min(1)
    maps = [
        (answer.normal + 1) / 2,
        _shown(answer.albedo, values),
        _shown(shade / peak, values),
        _shown(f_render(*answer), values),
    ]
    return [mask * part + (1 - mask) for part in maps]


def _shown(image: Tensor, values: Values) -> Tensor:
    image = image.clamp(0, 1)
    return linear_to_srgb(image) if values == "linear" else image
