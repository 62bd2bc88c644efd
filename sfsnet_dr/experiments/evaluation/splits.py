"""Nobody is measured on whom a network was fine-tuned with their normals: what is left for each method.

Networks that have learnt from pictures whose labels they helped to make themselves (``calibrated_by`` of
``IdentitySplit``) know no truth of anybody and are measured on everybody; what they do with those whose
pictures they have never seen, the unseen subjects, is told beside it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.normal_dataset import IdentitySplit, read_split
from sfsnet_dr.experiments.evaluation.measure import MethodErrors
from sfsnet_dr.experiments.evaluation.samples import Collection
from sfsnet_dr.inference.methods import Method, NetworkMethod


def fine_tuning_split(method: Method) -> IdentitySplit | None:
    """The identity split of a network that was trained with somebody's true normals."""
    split = _split(method)
    return None if split is None or split.calibrated_by else split


def unseen_subjects(methods: Sequence[Method], collection: Collection) -> Collection:
    """The photographs of subjects that none of the methods has learnt the normals of, by their names.

    Raises:
        InputError: if nobody is left.
    """
    splits = {method.name: split for method in methods if (split := fine_tuning_split(method)) is not None}
    learnt = {subject for split in splits.values() for subject in split.learnt}
    if not learnt.intersection(collection.subjects):
        return collection
    shots = [shot for shot in collection.shots if shot.subject not in learnt]
    if not shots:
        raise InputError(
            f"{', '.join(splits)}: trained with the normals of all {len(collection.subjects)} subjects of "
            f"{collection.data}; nobody is left to measure on"
        )
    return replace(collection, shots=shots)


def is_heldout(method: Method, found: MethodErrors) -> MethodErrors | None:
    """What was measured on those whose pictures a network has not seen; None if it has seen all or none."""
    split = _split(method)
    if split is None or not split.calibrated_by:
        return None
    images = [errors for errors in found.images if errors.shot.subject not in split.learnt]
    if not 0 < len(images) < len(found.images):
        return None
    return replace(found, method=f"{found.method}-unseen", images=images)


def cross_validated(methods: Sequence[Method], found: Sequence[MethodErrors]) -> list[MethodErrors]:
    """Everybody by the network that was not told their normals, where all folds of a fine-tuning are there.

    Folds belong together if their methods' names differ in the fold alone. Photographs a second are those of
    all folds' photographs. Other databases than the one they learnt from, where each fold is measured on
    everybody, are not pooled.
    """
    groups: dict[tuple[str, int], dict[int, MethodErrors]] = {}
    for method, measured in zip(methods, found, strict=True):
        split = fine_tuning_split(method)
        if split is not None:
            name = measured.method.removesuffix(fold_suffix(split))
            groups.setdefault((name, split.folds), {})[split.fold] = measured
    pooled = []
    for (name, folds), parts in groups.items():
        images = [errors for part in parts.values() for errors in part.images]
        if len(parts) == folds > 1 and len({errors.shot for errors in images}) == len(images):
            seconds = sum(len(part.images) / part.images_per_s for part in parts.values())
            pooled.append(MethodErrors(f"{name}-all{folds}folds", images, len(images) / seconds))
    return pooled


def without_folds(names: Sequence[str]) -> list[str]:
    """Names of methods, those of folds left out that are measured together under a name of their own."""
    pooled = {found[1] for name in names if (found := re.fullmatch(r"(.*)-all\d+folds", name))}
    return [name for name in names if re.sub(r"-fold\d+of\d+$", "", name) not in pooled]


def fold_suffix(split: IdentitySplit) -> str:
    """What the name of a fine-tuned method ends in."""
    return f"-fold{split.fold}of{split.folds}"


def shown_together(
    methods: Sequence[Method], first: Method, collection: Collection
) -> tuple[list[Method], Collection]:
    """Methods, ``first`` and then as many as leave somebody whom none of them has learnt from, and those."""
    chosen = [first]
    for method in methods:
        if method is first:
            continue
        try:
            unseen_subjects([*chosen, method], collection)
        except InputError:
            continue
        chosen.append(method)
    return [method for method in methods if method in chosen], unseen_subjects(chosen, collection)


def provenance_notes(methods: Sequence[Method], collection: Collection) -> list[str]:
    """A sentence for each method that has seen some of the subjects before."""
    notes = []
    for method in methods:
        split, left = _split(method), unseen_subjects([method], collection)
        if split is not None and left is not collection:
            by_sight = sorted(set(split.seen).intersection(left.subjects))
            notes.append(
                f"{method.name} was fine-tuned on other subjects of {split.database} (fold {split.fold} of "
                f"{split.folds} held back) and is measured on {', '.join(left.subjects)} only: "
                f"{len(left.shots)} of {len(collection.shots)} photographs."
                + (
                    f" It had learnt from pictures of {', '.join(by_sight)} without labels."
                    if by_sight
                    else ""
                )
            )
        elif split is not None and (seen := set(split.learnt).intersection(collection.subjects)):
            others = sorted(set(collection.subjects) - seen)
            notes.append(
                f"{method.name} has learnt from pictures of {len(seen)} of the {len(collection.subjects)} "
                "subjects without being told their normals, albedo or lights (photometric stereo with lamps "
                f"that were found with the help of {split.calibrated_by})."
                + (f" {method.name}-unseen: the same network on {', '.join(others)}." if others else "")
            )
    return notes


def _split(method: Method) -> IdentitySplit | None:
    return read_split(method.trained.metadata) if isinstance(method, NetworkMethod) else None
