"""Nobody is measured on whom a network was fine-tuned with their normals: what is left for each method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sfsnet_dr.apply.methods import Method, NetworkMethod
from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.data.surface_faces import IdentitySplit, read_split
from sfsnet_dr.study.evaluate.shots import Collection


def split_of(method: Method) -> IdentitySplit | None:
    """The identity split that a network was trained with, if any."""
    return read_split(method.trained.metadata) if isinstance(method, NetworkMethod) else None


def unseen(methods: Sequence[Method], collection: Collection) -> Collection:
    """The photographs of subjects that none of the methods has learnt the normals of, by their names.

    Raises:
        BadInput: if nobody is left.
    """
    splits = {method.name: split for method in methods if (split := split_of(method)) is not None}
    learnt = {subject for split in splits.values() for subject in split.learnt}
    if not learnt.intersection(collection.subjects):
        return collection
    shots = [shot for shot in collection.shots if shot.subject not in learnt]
    if not shots:
        raise BadInput(
            f"{', '.join(splits)}: trained with the normals of all {len(collection.subjects)} subjects of "
            f"{collection.data}; nobody is left to measure on"
        )
    return replace(collection, shots=shots)


def told(methods: Sequence[Method], collection: Collection) -> list[str]:
    """A sentence for each method that is measured on fewer subjects than the others."""
    notes = []
    for method in methods:
        split, left = split_of(method), unseen([method], collection)
        if split is not None and left is not collection:
            notes.append(
                f"{method.name} was fine-tuned on other subjects of {split.database} (fold {split.fold} of "
                f"{split.folds} held back) and is measured on {', '.join(left.subjects)} only: "
                f"{len(left.shots)} of {len(collection.shots)} photographs."
            )
    return notes
