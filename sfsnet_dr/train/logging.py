"""The training history: ``history.jsonl``, TensorBoard, and sample images."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import torch
from torch import Tensor, nn

from sfsnet_dr.core import files
from sfsnet_dr.core.color_torch import linear_to_srgb
from sfsnet_dr.core.errors import InputError, NotInstalled
from sfsnet_dr.core.image_io import write_png
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.mixed_batch import MixedBatch
from sfsnet_dr.data.pseudo_labels import Encoding
from sfsnet_dr.models.base import NetworkOutput
from sfsnet_dr.models.inference import predict
from sfsnet_dr.render.shading_torch import f_render, shading


class History:
    """The history of one run; each line is on disk when ``add`` returns.

    Args:
        path: the file.
        first_step: the step that comes next. Lines of it and of later steps, which a run that was cut off
            after its last checkpoint may have left, are removed; so is everything at step 0.
    """

    def __init__(self, path: Path, first_step: int) -> None:
        kept = [line for line in read_history(path) if line["step"] < first_step] if path.exists() else []
        files.write_text(path, "".join(json.dumps(line) + "\n" for line in kept))
        self._file = path.open("a", encoding="utf-8")

    def add(self, **values: Any) -> None:
        """Append a line."""
        self._file.write(json.dumps(values) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def read_history(path: Path | str) -> list[dict[str, Any]]:
    """All whole lines of a history: step, rate, total, recon, normal, albedo, light, images_per_second.

    A skipped step has ``skipped`` (the reason) instead of the losses. A last line without its end, as a crash
    leaves it, is left out.

    Raises:
        InputError: if the file is missing or a whole line is no JSON.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; `sfsnet-dr train` writes it")
    text = path.read_text(encoding="utf-8")
    try:
        return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]
    except ValueError as error:
        raise InputError(f"{path}: not a training history ({error})") from error


#: Folder of its files below that of the run.
FOLDER: Final = "tensorboard"


class TensorBoardLogger:
    """Writes the numbers of steps for TensorBoard.

    Args:
        folder: of the run.
        first_step: what an earlier run wrote of this and later steps is hidden.

    Raises:
        NotInstalled: without the ``tensorboard`` extra.
    """

    def __init__(self, folder: Path, first_step: int) -> None:
        if importlib.util.find_spec("tensorboard") is None:
            raise NotInstalled(
                "tensorboard: not installed; pip install 'sfsnet_dr[tensorboard]', or leave --tensorboard out"
            )
        from torch.utils.tensorboard.writer import SummaryWriter

        self._writer: Any = SummaryWriter(str(folder / FOLDER), purge_step=first_step)

    def add(self, step: int, values: dict[str, Any]) -> None:
        """Note every number of a step."""
        for name, value in values.items():
            if isinstance(value, int | float) and name != "step":
                self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Write what is left."""
        self._writer.close()


#: Faces of each kind, at most.
ROWS: Final = 4


def write_sample_images(
    path: Path, model: nn.Module, batch: FaceBatch | MixedBatch, values: Encoding
) -> None:
    """Write a PNG with a row for each face: image, normals, albedo, shading and product; then the labels'.

    Rendered faces come first, photographs with their pseudo-labels after them. The network answers as it
    would after training: with the running statistics of batch normalisation.
    """
    kinds = [batch] if isinstance(batch, FaceBatch) else [batch.labelled, batch.real.faces]
    rows = []
    for kind in kinds:
        kind = FaceBatch(*(part[:ROWS] for part in kind))
        answer = predict(model, kind.image)
        labels = _columns(NetworkOutput(kind.normal, kind.albedo, kind.light), kind.mask, values)
        shown = [_shown(kind.image, values), *_columns(answer, kind.mask, values), *labels]
        rows.append(torch.cat(shown, dim=3))
    grid = torch.cat([row for kind in rows for row in kind], dim=1)
    write_png(path, grid.permute(1, 2, 0).cpu().numpy(), encoded=True)


def _columns(answer: NetworkOutput, mask: Tensor, values: Encoding) -> list[Tensor]:
    shade = shading(answer.normal, answer.light)
    peak = (shade * mask).amax((1, 2, 3), keepdim=True).clamp_min(1)
    maps = [
        (answer.normal + 1) / 2,
        _shown(answer.albedo, values),
        _shown(shade / peak, values),
        _shown(f_render(*answer), values),
    ]
    return [mask * part + (1 - mask) for part in maps]


def _shown(image: Tensor, values: Encoding) -> Tensor:
    image = image.clamp(0, 1)
    return linear_to_srgb(image) if values == "linear" else image
