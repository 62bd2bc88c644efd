"""A trained network with what its recipe says about the images that it understands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.base.conventions import FACE_SIZE
from sfsnet_dr.data.pseudo_labels import Values
from sfsnet_dr.data.view import View
from sfsnet_dr.model.network import Network
from sfsnet_dr.model.weights import load_weights, read_metadata


@dataclass(frozen=True, eq=False)
class Trained:
    """A network as ``sfsnet-dr train`` left it.

    Attributes:
        model: in evaluation mode, on the CPU.
        view: what it was shown of the frame, and with how many pixels; it answers best for that, and some
            networks at no other size.
        values: what a photograph's numbers are to it.
        metadata: everything that its file says.
    """

    model: Network
    view: View
    values: Values
    metadata: dict[str, Any]


def load_trained(weights: Path | str) -> Trained:
    """Read weights; a file without a recipe counts as trained on linear images of 128 x 128.

    Raises:
        BadInput: for unusable weights.
    """
    metadata = read_metadata(weights)
    recipe = metadata.get("recipe", {})
    data = recipe.get("data", {})
    view = View(int(data.get("size") or FACE_SIZE), int(data.get("crop") or FACE_SIZE))
    if not 1 <= view.size <= view.crop <= FACE_SIZE:
        raise BadInput(
            f"{weights}: trained on {view.crop} of the frame's {FACE_SIZE} pixels shown with {view.size}, no "
            "more pixels than are shown are needed"
        )
    return Trained(load_weights(weights), view, recipe.get("real", {}).get("values", "linear"), metadata)
