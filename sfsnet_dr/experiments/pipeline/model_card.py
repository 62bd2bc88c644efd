"""Measure shipped networks anew, and hold the numbers to those of their cards.

The faces are rendered here, from seeds that no training uses, so that anybody gets the same numbers without
any data; photographs that one has are measured too where a folder of them is given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import output_dir
from sfsnet_dr.data.dataset import load_faces
from sfsnet_dr.data.generate import synthesize
from sfsnet_dr.data.photos import photo_folder
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.experiments.pipeline.holdout_split import (
    error_records,
    holdout_batch,
    photograph_errors,
    rendered_errors,
)
from sfsnet_dr.models.inference import LoadedModel, load_model
from sfsnet_dr.models.shipped import FOLDER, weights_name
from sfsnet_dr.report.record import Record, read_records
from sfsnet_dr.scene.spec import SceneSpec

#: Faces that are rendered, the first of their seeds, and the pictures that are taken of them.
FACES: Final = 24
FIRST_SEED: Final = 900_000
PICTURES: Final = 96

#: Photographs that are measured: as many as are held back from training.
PHOTOGRAPHS: Final = 500

#: Share of a card's number within which a number counts as the same. On one machine the numbers repeat; other
#: processors round otherwise, and a path that flips at an edge changes a pixel of a few.
SAME: Final = 0.01


@dataclass(frozen=True)
class Comparison:
    """A number now and on the card; the card's is None where it tells none."""

    record: Record
    card: float | None

    @property
    def same(self) -> bool:
        """Whether they agree; true where the card tells nothing."""
        return self.card is None or abs(self.record.value - self.card) <= SAME * abs(self.card)

    def __str__(self) -> str:
        told = "not on the card" if self.card is None else f"card {self.card:.4g}"
        state = "" if self.same else ": DIFFERS"
        return f"{self.record.what}: {self.record.value:.4g} {self.record.unit}, {told}{state}"


def measure_shipped(
    names: Sequence[Path | str],
    out: Path | str,
    command: str,
    *,
    photographs: Path | None = None,
    on_face: Callable[[int], None] | None = None,
) -> list[Record]:
    """Numbers of networks on rendered faces, and on photographs where there are some.

    Args:
        names: shipped names, or files of weights.
        out: folder for the rendered faces, which are used again.
        command: for the records.
        photographs: folder of photographs with landmarks; ``PHOTOGRAPHS`` of them are measured.
        on_face: called with the seed of each face that was rendered.

    Raises:
        InputError: for unusable weights or photographs, or two networks of one name.
    """
    networks = _loaded(names)
    folder = output_dir(out) / "faces"
    synthesize(folder, SceneSpec("faces", "anny"), FACES, seed=FIRST_SEED, resume=True, on_face=on_face)
    source = None if photographs is None else photo_folder(photographs, held_back=PHOTOGRAPHS)
    shown = {}
    if source is not None:  # once for all networks of a view
        shown = {view: source.load(source.held, view) for view in {each.crop for each in networks.values()}}
    records: list[Record] = []
    for name, trained in networks.items():
        wanted = Augmentation(size=trained.crop.size, crop=trained.crop.crop)
        truth = holdout_batch(load_faces(folder, trained.crop), wanted, PICTURES)
        records += error_records(rendered_errors(trained, truth), "synthetic", name, command)
        if source is not None:
            records += error_records(
                photograph_errors(trained, shown[trained.crop]), "photographs", name, command
            )
    return records


def _loaded(names: Sequence[Path | str]) -> Mapping[str, LoadedModel]:
    networks: dict[str, LoadedModel] = {}
    for given in names:
        name = weights_name(given)
        if name in networks:
            raise InputError(f"names: two networks would be called {name!r}; rename {given}")
        networks[name] = load_model(given)
    return networks


def card_records(name: str) -> list[Record]:
    """The numbers of a shipped network's card."""
    return read_records(FOLDER / f"{name}.json")


def compare_with_card(records: Sequence[Record], card: Sequence[Record]) -> list[Comparison]:
    """Each record beside the card's number of the same name."""
    known = {record.what: record.value for record in card}
    return [Comparison(record, known.get(record.what)) for record in records]
