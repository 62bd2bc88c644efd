"""TensorBoard beside the history, where it is installed and wanted."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any, Final

from sfsnet_dr.base.checks import NotInstalled

#: Folder of its files below that of the run.
FOLDER: Final = "tensorboard"


class Board:
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
