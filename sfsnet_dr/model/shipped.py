"""Trained networks that come with the package, by name; ``sfsnet_dr/weights/NAME.md`` is the card of each."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from sfsnet_dr.base.checks import BadInput, nearest

#: Names that stand for files of weights wherever such a file is asked for.
SHIPPED: Final = ("sfsnet", "skipnet", "skipnet-plus")

#: The one that is used where none is named: by their cards it has the best normals.
BEST: Final = "skipnet"

FOLDER: Final = Path(__file__).parents[1] / "weights"


def weights_path(given: Path | str) -> Path:
    """The file that a name of ``SHIPPED`` stands for; any other path as it is.

    Raises:
        BadInput: for a bare word that is neither a shipped name nor a file.
    """
    name, path = str(given), Path(given)
    if name in SHIPPED:
        return FOLDER / f"{name}.safetensors"
    if path.name == name and not path.suffix and not path.exists():
        raise BadInput(f"weights: {name!r} is no file, and no shipped network: {nearest(name, SHIPPED)}")
    return path


def weights_name(given: Path | str) -> str:
    """What weights are called in tables and records: their file, or the run of a weights.safetensors."""
    path = Path(given)
    return path.absolute().parent.name if path.stem == "weights" else path.stem
