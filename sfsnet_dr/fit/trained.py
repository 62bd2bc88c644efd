"""A trained network with what its recipe says about the images that it understands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.base.conventions import FACE_SIZE
from sfsnet_dr.data.pseudo_labels import Values
from sfsnet_dr.model.network import Network
from sfsnet_dr.model.weights import load_weights, read_metadata


@dataclass(frozen=True, eq=False)
class Trained:
    """A network as ``sfsnet-dr train`` left it.

    Attributes:
        model: in evaluation mode, on the CPU.
        size: width and height of the images that it was trained on; it answers best at that size, and some
            networks at no other.
        values: what a photograph's numbers are to it.
        metadata: everything that its file says.
    """

    model: Network
    size: int
    values: Values
    metadata: dict[str, Any]


def load_trained(weights: Path | str) -> Trained:
    """Read weights; a file without a recipe counts as trained on linear images of 128 x 128.

    Raises:
        BadInput: for unusable weights.
    """
    metadata = read_metadata(weights)
    recipe = metadata.get("recipe", {})
    size = int(recipe.get("data", {}).get("size") or FACE_SIZE)
    if size < 1 or FACE_SIZE % size:
        raise BadInput(f"{weights}: trained on {size} x {size} pixels, a divisor of {FACE_SIZE} is needed")
    return Trained(load_weights(weights), size, recipe.get("real", {}).get("values", "linear"), metadata)
