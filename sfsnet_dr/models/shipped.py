"""Trained networks that come with the package, by name; ``models/weights/NAME.md`` is the card of each."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from sfsnet_dr.core.errors import InputError, nearest

#: Names that stand for files of weights wherever such a file is asked for.
SHIPPED: Final = ("sfsnet", "skipnet", "skipnet-plus")

#: The same networks before the stage that added the last four subjects of Extended Yale B: these four are
#: held out, and the headline numbers are theirs.
HELDOUT: Final = ("sfsnet-heldout", "skipnet-heldout", "skipnet-plus-heldout")

#: The default network: by the cards it has the best normals.
BEST: Final = "skipnet"

FOLDER: Final = Path(__file__).with_name("weights")


def weights_path(given: Path | str) -> Path:
    """Return the file that a shipped name stands for; any other path as it is.

    Raises:
        InputError: for a bare word that is neither a shipped name nor a file.
    """
    name, path = str(given), Path(given)
    if name in (*SHIPPED, *HELDOUT):
        return FOLDER / f"{name}.safetensors"
    if path.name == name and not path.suffix and not path.exists():
        raise InputError(
            f"weights: {name!r} is no file, and no shipped network: {nearest(name, (*SHIPPED, *HELDOUT))}"
        )
    return path


def weights_name(given: Path | str) -> str:
    """Return the name of weights in tables and records: the file, or the run of a weights.safetensors."""
    path = Path(given)
    return path.absolute().parent.name if path.stem == "weights" else path.stem
