"""Networks that have learnt from somebody are measured on others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.captures import SUBJECTS, write_faces

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.normal_dataset import IdentitySplit
from sfsnet_dr.experiments.evaluation.collect import Amount, collect_samples
from sfsnet_dr.experiments.evaluation.measure import measure_methods
from sfsnet_dr.experiments.evaluation.methods import RequestedMethod, methods_for
from sfsnet_dr.experiments.evaluation.records import normal_statistics
from sfsnet_dr.experiments.evaluation.run import evaluate
from sfsnet_dr.experiments.evaluation.samples import Collection, EvaluationSample
from sfsnet_dr.experiments.evaluation.splits import (
    cross_validated,
    is_heldout,
    provenance_notes,
    shown_together,
    unseen_subjects,
    without_folds,
)
from sfsnet_dr.inference.methods import NetworkMethod
from sfsnet_dr.models.sfsnet import SfSNet
from sfsnet_dr.models.weights import save_weights


def tuned(folder: Path, learnt: tuple[str, ...], lamps_by: str = "", by_sight: tuple[str, ...] = ()) -> Path:
    """Weights that say that they have learnt from some subjects."""
    torch.manual_seed(0)
    held = tuple(name for name in SUBJECTS if name not in learnt)
    split = IdentitySplit("balls", 4, 1, learnt, held, lamps_by, by_sight)
    path = folder / "ft.safetensors"
    save_weights(path, SfSNet(2, 2, 1), {"recipe": {"data": {"size": 32}}, "normal_labels": split.metadata})
    return path


def test_nobody_learnt_from_is_left_for_a_fine_tuned_network(tmp_path: Path) -> None:
    shots = [
        EvaluationSample(
            f"{name}{k}", name, name, torch.zeros(3, 4, 4), torch.zeros(1, 4, 4), np.ones((4, 4))
        )
        for name in SUBJECTS
        for k in range(4)
    ]
    collection = Collection("balls", shots, "")
    methods, _ = methods_for(shots, RequestedMethod(("flat",), (tuned(tmp_path, SUBJECTS[:4]),)))
    assert [method.name for method in methods] == ["flat", "ft-fold1of4"]
    assert unseen_subjects(methods[:1], collection) is collection
    assert unseen_subjects(methods, collection).subjects == list(SUBJECTS[4:])
    [note] = provenance_notes(methods, collection)
    assert "measured on a5, a6 only: 8 of 24 photographs" in note
    assert "without labels" not in note
    by_sight, _ = methods_for(
        shots, RequestedMethod(("flat",), (tuned(tmp_path, SUBJECTS[:4], "", SUBJECTS[5:]),))
    )
    [note] = provenance_notes(by_sight, collection)
    assert "It had learnt from pictures of a6 without labels" in note
    methods, _ = methods_for(shots, RequestedMethod(("flat",), (tuned(tmp_path, SUBJECTS),)))
    with pytest.raises(InputError, match="nobody is left to measure on"):
        unseen_subjects(methods, collection)


def test_a_network_that_was_told_no_truth_is_measured_on_everybody(tmp_path: Path) -> None:
    collection = collect_samples("labels", [write_faces(tmp_path / "labels", size=128)], Amount())
    path = tuned(tmp_path, SUBJECTS[:4], lamps_by="skipnet")
    methods, _ = methods_for(collection.shots, RequestedMethod(("flat",), (path,)))
    assert [method.name for method in methods] == ["flat", "ft"]
    assert unseen_subjects(methods, collection) is collection
    [note] = provenance_notes(methods, collection)
    assert "from pictures of 4 of the 6 subjects without being told" in note
    assert "ft-unseen: the same network on a5, a6" in note
    found = measure_methods(methods[1], collection.shots)
    assert is_heldout(methods[0], found) is None
    apart = is_heldout(methods[1], found)
    assert apart is not None
    assert apart.method == "ft-unseen"
    assert {errors.shot.subject for errors in apart.images} == set(SUBJECTS[4:])
    records = {record.what: record.value for record in evaluate(collection, methods, tmp_path / "out", "")}
    pooled = normal_statistics(apart.images)["mean_deg"]
    assert records["balls.ft_unseen.normals.mean_deg"] == pytest.approx(pooled)
    assert records["balls.ft.normals.mean_deg"] != records["balls.ft_unseen.normals.mean_deg"]
    assert "ft-unseen" in (tmp_path / "out" / "index.html").read_text()
    methods, _ = methods_for(
        collection.shots, RequestedMethod(("flat",), (tuned(tmp_path, SUBJECTS, "skipnet"),))
    )
    assert is_heldout(methods[1], found) is None


def test_all_folds_together_measure_everybody_once(tmp_path: Path) -> None:
    """Each subject by the network that held it back; a page can be written, though nobody is left to all."""
    collection = collect_samples("labels", [write_faces(tmp_path / "labels", size=128)], Amount())
    paths = []
    for fold in range(2):
        torch.manual_seed(fold)
        parts = SUBJECTS[:2], SUBJECTS[2:]
        split = IdentitySplit("balls", 2, fold, parts[1 - fold], parts[fold])
        paths.append(tmp_path / f"{fold}" / "ft.safetensors")
        paths[-1].parent.mkdir()
        recipe = {"data": {"size": 32}}
        save_weights(paths[-1], SfSNet(2, 2, 1), {"recipe": recipe, "normal_labels": split.metadata})
    methods, _ = methods_for(collection.shots, RequestedMethod(("flat",), tuple(paths)))
    assert [method.name for method in methods] == ["flat", "ft-fold0of2", "ft-fold1of2"]
    records = {record.what: record.value for record in evaluate(collection, methods, tmp_path / "out", "")}
    found = [measure_methods(method, unseen_subjects([method], collection).shots) for method in methods]
    [whole] = cross_validated(methods, found)
    assert whole.method == "ft-all2folds"
    assert sorted(errors.shot.name for errors in whole.images) == sorted(s.name for s in collection.shots)
    own = [errors.normals.all for part in found[1:] for errors in part.images if errors.normals is not None]
    pixels, total = np.sum(own, axis=0)[:2]
    assert records["balls.ft_all2folds.normals.mean_deg"] == pytest.approx(total / pixels)
    assert cross_validated(methods[:2], found[:2]) == []
    assert cross_validated(methods[1:], [replace(part, images=whole.images) for part in found[1:]]) == []
    names = ["flat", "ft-fold0of2", "ft-fold1of2", "other-fold0of2", "ft-all2folds"]
    assert without_folds(names) == ["flat", "other-fold0of2", "ft-all2folds"]
    together, theirs = shown_together(methods, methods[1], collection)
    assert [method.name for method in together] == ["flat", "ft-fold0of2"]
    assert theirs.subjects == list(SUBJECTS[:2])
    assert "ft-all2folds" in (tmp_path / "out" / "index.html").read_text()


@pytest.mark.slow
def test_evaluation_measures_on_held_back_subjects_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    collection = collect_samples("labels", [write_faces(tmp_path / "labels", size=128)], Amount())
    methods, _ = methods_for(collection.shots, RequestedMethod(("flat",), (tuned(tmp_path, SUBJECTS[:4]),)))
    asked: list[str] = []
    call = NetworkMethod.__call__

    def noted(self: Any, images: Any, masks: Any, subjects: Any) -> Any:
        asked.extend(subjects)
        return call(self, images, masks, subjects)

    monkeypatch.setattr(NetworkMethod, "__call__", noted)
    records = evaluate(collection, methods, tmp_path / "out", "")
    assert set(asked) == set(SUBJECTS[4:])
    assert any(record.what == "balls.ft_fold1of4.normals.mean_deg" for record in records)
    assert "measured on a5, a6 only: 8 of 24" in (tmp_path / "out" / "index.html").read_text()
