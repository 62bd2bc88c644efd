"""Fine-tuning on labels by photometric stereo: labels stay true, and nobody held back is ever seen."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.captures import SIZE, SUBJECTS, face, write_faces
from hypothesis import given, settings
from hypothesis import strategies as st

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.mixed_batch import MixedBatch, PseudoLabelOptions
from sfsnet_dr.data.normal_dataset import (
    USUAL_ALBEDO,
    IdentitySplit,
    NormalLabelFaces,
    NormalLabelOptions,
    fold_of,
    load_training_subjects,
    read_split,
    split_subjects,
)
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.losses.sfsnet import LARGEST_FACTOR, LossWeights, match_albedo_scale, mixed_loss
from sfsnet_dr.models.base import NetworkOutput
from sfsnet_dr.models.weights import read_metadata, save_weights
from sfsnet_dr.render.shading_torch import f_render
from sfsnet_dr.train.config import ComputeRecipe, ModelRecipe, Recipe, read_recipe
from sfsnet_dr.train.sources import configure_sources
from sfsnet_dr.train.step import training_step
from sfsnet_dr.train.trainer import train

RECIPE = Recipe(
    steps=4,
    batch_size=4,
    checkpoint_every=2,
    model=ModelRecipe(stem=4, features=8, blocks=1),
    data=Augmentation(num_lights=4, size=SIZE),
    normal_labels=NormalLabelOptions(batch_fraction=0.5, folds=2),
    compute=ComputeRecipe(precision="float32", loss_backend="torch"),
)


def test_flips_and_exposure_keep_labels_and_pictures_together() -> None:
    faces = NormalLabelFaces([face(name) for name in SUBJECTS], 8, NormalLabelOptions(exposure=1.0), seed=0)
    for step in range(3):
        batch, confidence, *_ = faces.batch(step)
        drawn = f_render(batch.normal, batch.albedo, batch.light)
        kept = batch.image < 0.999  # what is brighter is clipped, as a camera does
        assert float((drawn - batch.image)[kept].abs().max()) < 2e-3  # kept as halves
        assert float((drawn.roll(1, 0) - batch.image).abs().mean()) > 0.02
        assert (batch.image[:, :1] == batch.image).all()
        assert (batch.light[:, :9] == batch.light[:, 9:18]).all()
        assert confidence.min() == 0.5
    turned = (
        NormalLabelFaces([face("a1")], 4, NormalLabelOptions(flip=1.0, exposure=0.0), seed=0).batch(0).faces
    )
    plain = (
        NormalLabelFaces([face("a1")], 4, NormalLabelOptions(flip=0.0, exposure=0.0), seed=0).batch(0).faces
    )
    torch.testing.assert_close(turned.image.flip(-1), plain.image, rtol=1e-5, atol=1e-6)
    assert torch.equal(turned.normal[:, 0].flip(-1), -plain.normal[:, 0])


def test_batches_are_functions_of_the_step_and_see_every_picture() -> None:
    faces = [face(name) for name in SUBJECTS[:2]]
    first, second = (NormalLabelFaces(faces, 4, NormalLabelOptions(), seed=3) for _ in range(2))
    assert torch.equal(first.batch(5).faces.image, second.batch(5).faces.image)
    assert sorted(first.names(0) + first.names(1)) == sorted(f"{f.name}: {x}" for f in faces for x in "abcd")
    halves = [first.batch(2, rank, 2).faces.image for rank in range(2)]
    torch.testing.assert_close(torch.cat(halves), first.batch(2).faces.image)


@given(
    st.sets(st.text("abcxyz0123456789", min_size=1, max_size=8), min_size=2, max_size=40),
    st.integers(2, 6),
    st.integers(0, 5),
)
@settings(max_examples=60, deadline=None)
def test_a_split_never_leaks(names: set[str], folds: int, fold: int) -> None:
    options = NormalLabelOptions(batch_fraction=0.5, folds=folds, fold=fold % folds)
    try:
        split = split_subjects(names, options, "x")
    except InputError:
        assert len({fold_of(name, folds) == options.fold for name in names}) == 1  # all or none
        return
    assert set(split.learnt) | set(split.held_back) == names
    assert not set(split.learnt) & set(split.held_back)
    # Nobody changes sides when somebody else leaves.
    for name in names:
        assert (name in split.held_back) == (fold_of(name, folds) == options.fold)


def test_training_sees_no_picture_of_anybody_held_back(surfaces: Path) -> None:
    seen = set()
    for fold in range(2):
        options = NormalLabelOptions(batch_fraction=0.5, folds=2, fold=fold)
        faces, split = load_training_subjects(surfaces, options, Crop(8))
        batches = NormalLabelFaces(faces, 4, options, seed=0)
        assert batches.pixels == (8, 8)
        names = {name.split(":")[0] for step in range(12) for name in batches.names(step)}
        assert names == set(split.learnt)
        assert not names & set(split.held_back)
        seen |= set(split.held_back)
    assert seen == set(SUBJECTS)


def test_albedo_and_light_count_up_to_a_factor(surfaces: Path) -> None:
    real = NormalLabelFaces([face("a2")], 4, NormalLabelOptions(), seed=0).batch(0)
    batch = real.faces
    true = NetworkOutput(batch.normal, 1.8 * batch.albedo, batch.light / 1.8)
    both = NetworkOutput(*(torch.cat([part, part]) for part in true))
    labelled = FaceBatch(batch.image, *true, batch.mask)
    weights = LossWeights()
    free = MixedBatch(labelled, real)
    _, _, terms = mixed_loss(both, free, weights, weights, "torch")
    assert float(terms.albedo) < 1e-6
    assert float(terms.light) < 1e-9
    told = free._replace(real=real._replace(free_scale=torch.zeros(4, dtype=torch.bool)))
    _, _, fixed = mixed_loss(both, told, weights, weights, "torch")
    assert float(fixed.albedo) > 0.1


def test_the_median_capture_has_the_albedo_of_usual_skin() -> None:
    """One factor for all captures, so that they keep what they differ by; light has its inverse."""
    options = NormalLabelOptions(flip=0.0, exposure=0.0)
    labels = [face(name) for name in SUBJECTS[:3]]
    dark = [replace(part, albedo=0.05 * part.albedo, gain=20 * part.gain) for part in labels]
    means = []
    for kind in (labels, dark):
        first = NormalLabelFaces(kind, 12, options, seed=0).batch(0).faces
        drawn = f_render(first.normal, first.albedo, first.light)
        assert float((drawn - first.image)[first.image < 0.999].abs().max()) < 2e-3
        weight = first.mask / first.mask.sum((1, 2, 3), keepdim=True)
        means.append((weight * first.albedo[:, :1]).sum((1, 2, 3)))
    assert means[0].median() == pytest.approx(USUAL_ALBEDO, rel=1e-4)
    torch.testing.assert_close(*means)
    assert means[0].max() / means[0].min() > 1.01


def test_a_smooth_answer_is_not_told_to_be_darker() -> None:
    """It would be by a scale of least squares: detail that the answer lacks makes that one small."""
    real = NormalLabelFaces([face("a2")], 4, NormalLabelOptions(), seed=0).batch(0)
    weight = real.faces.mask * real.confidence
    answer = NetworkOutput(real.faces.normal, torch.full_like(real.faces.albedo, 0.25), real.faces.light)
    labels = match_albedo_scale(answer, real)
    told, said = ((weight * part).sum((1, 2, 3)) for part in (labels.albedo, answer.albedo))
    torch.testing.assert_close(told, said)
    factor = labels.albedo[:, 0, 4, 4] / real.faces.albedo[:, 0, 4, 4]
    torch.testing.assert_close(labels.light * factor[:, None], real.faces.light)
    product, power = (
        (weight * real.faces.albedo * part).sum((1, 2, 3)) for part in (answer.albedo, real.faces.albedo)
    )
    assert (product / power < 0.97 * factor).all()
    sunk = match_albedo_scale(answer._replace(albedo=0.1 * real.faces.albedo), real)
    torch.testing.assert_close(sunk.albedo, real.faces.albedo / LARGEST_FACTOR)


def test_a_fine_tuning_is_resumed_to_the_bit_and_tells_its_split(
    surfaces: Path, spheres: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = tmp_path / "start.safetensors"
    save_weights(start, RECIPE.make_model())
    whole = train(RECIPE, spheres, tmp_path / "whole", surfaces=surfaces, start=start, progress=False)
    assert {"real_normal", "real_recon"} <= set(whole.final)
    with monkeypatch.context() as patch:
        calls = iter(range(5))

        def step(*arguments: Any) -> dict[str, float]:
            if next(calls) == 3:
                raise RuntimeError("power cut")
            return training_step(*arguments)

        patch.setattr("sfsnet_dr.train.run.training_step", step)
        with pytest.raises(RuntimeError):
            train(RECIPE, spheres, tmp_path / "cut", surfaces=surfaces, start=start, progress=False)
    cut = train(
        RECIPE, spheres, tmp_path / "cut", surfaces=surfaces, start=start, resume=True, progress=False
    )
    assert cut.weights.read_bytes() == whole.weights.read_bytes()
    split = read_split(read_metadata(whole.weights))
    assert split == split_subjects(SUBJECTS, RECIPE.normal_labels, "balls")
    other = replace(RECIPE, normal_labels=replace(RECIPE.normal_labels, fold=1))
    with pytest.raises(InputError, match=r"was trained on .*, which this fold holds out"):
        train(other, spheres, tmp_path / "o", surfaces=surfaces, start=whole.weights, progress=False)


def test_one_part_holds_nobody_back(surfaces: Path) -> None:
    faces, split = load_training_subjects(surfaces, NormalLabelOptions(batch_fraction=0.5, folds=1))
    assert [face.subject for face in faces] == list(split.learnt) == list(SUBJECTS)
    assert split.held_back == ()


def test_weights_tell_whose_pictures_and_whose_truth_they_know(surfaces: Path, tmp_path: Path) -> None:
    """Pictures of those held back may have been learnt from, their truth may not; truth stays told."""

    def weights(folds: int, fold: int, lamps_by: str) -> Path:
        split = split_subjects(SUBJECTS, NormalLabelOptions(folds=folds, fold=fold), "balls")
        path = tmp_path / f"{folds}-{fold}-{lamps_by}.safetensors"
        save_weights(
            path, RECIPE.make_model(), {"normal_labels": replace(split, calibrated_by=lamps_by).metadata}
        )
        return path

    def begun(start: Path, surfaces: Path = surfaces) -> IdentitySplit | None:
        return read_split(configure_sources(RECIPE, None, surfaces, start).metadata)

    dealt = split_subjects(SUBJECTS, RECIPE.normal_labels, "balls")
    assert begun(weights(1, 0, "skipnet")) == replace(dealt, seen=dealt.held_back)
    assert begun(weights(2, 0, "skipnet")) == begun(weights(2, 0, "")) == dealt
    with pytest.raises(InputError, match=r"was trained on .*, which this fold holds out"):
        begun(weights(2, 1, ""))
    found = write_faces(tmp_path / "found", lamps_by="skipnet")
    with pytest.raises(InputError, match=r"was trained on .*, which this fold holds out"):
        begun(weights(1, 0, "skipnet"), found)
    with pytest.raises(
        InputError, match=r"was trained on ground-truth normals of .*Start from weights trained"
    ):
        begun(weights(2, 0, ""), found)


def test_bad_fine_tunings_are_told(surfaces: Path, spheres: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"surfaces: 1 subject found, two are needed"):
        load_training_subjects(write_faces(tmp_path / "one", SUBJECTS[:1]), RECIPE.normal_labels)
    alike = [n for n in (f"p{k}" for k in range(40)) if fold_of(n, 2) == 0]
    with pytest.raises(InputError, match=r"all of .* subjects would be held back by fold 0 of 2"):
        split_subjects(alike, NormalLabelOptions(folds=2), "x")
    with pytest.raises(InputError, match=r"none of .* subjects would be held back by fold 1 of 2"):
        split_subjects(alike, NormalLabelOptions(folds=2, fold=1), "x")
    with pytest.raises(InputError, match=r"surfaces\.fold: 4 found, 0 to 3 allowed"):
        NormalLabelOptions(fold=4)
    with pytest.raises(
        InputError, match=r"normal_labels\.batch_fraction: 0\.5 in the recipe and no folder of labels"
    ):
        train(RECIPE, spheres, tmp_path / "out", progress=False)
    with pytest.raises(InputError, match="2 and 2 of 4 images found, rendered faces are needed too"):
        replace(RECIPE, real=PseudoLabelOptions(batch_fraction=0.5))
    with pytest.raises(InputError, match="'srgb' found, 'linear' is needed"):
        replace(RECIPE, real=PseudoLabelOptions(encoding="srgb"))
    with pytest.raises(InputError, match=r"16 x 16 pixels found, a square of 22 .*; see data\.size"):
        load_training_subjects(surfaces, RECIPE.normal_labels, Crop(16, 96))
    older = write_faces(tmp_path / "older", SUBJECTS[:2])
    index = json.loads((older / "normal_labels.json").read_text()) | {"format": "sfsnet_dr.surfaces.0"}
    (older / "normal_labels.json").write_text(json.dumps(index))
    with pytest.raises(InputError, match=r"format 'sfsnet_dr\.surfaces\.0' found"):
        load_training_subjects(older, RECIPE.normal_labels)
    (tmp_path / "r.toml").write_text("steps = 1\n[normal_labels]\nfoldz = 3\n")
    with pytest.raises(InputError, match="unknown key 'foldz'"):
        read_recipe(tmp_path / "r.toml")


@pytest.mark.parametrize("kind", ["small", "full"])
def test_the_recipes_are_read(kind: str) -> None:
    recipe = read_recipe(Path(__file__).parents[2] / "training" / "recipes" / kind / "sfsnet-ft.toml")
    assert recipe.normal_labels.batch_fraction == 0.5
