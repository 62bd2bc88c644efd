"""Fine-tuning on labels by photometric stereo: labels stay true, and nobody held back is ever seen."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from spheres import write_spheres

from sfsnet_dr.apply.methods import NetworkMethod
from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.data.augment import Augmentation
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.mixture import MixedBatch, RealOptions
from sfsnet_dr.data.surface_faces import (
    IdentitySplit,
    SurfaceFaces,
    SurfaceOptions,
    fold_of,
    load_learnt,
    read_split,
    split_subjects,
)
from sfsnet_dr.data.surface_labels import SurfaceLabels, light_labels, write_index, write_surface
from sfsnet_dr.data.view import View
from sfsnet_dr.fit.recipe import ComputeRecipe, ModelRecipe, Recipe, read_recipe
from sfsnet_dr.fit.step import training_step
from sfsnet_dr.fit.trainer import train
from sfsnet_dr.loss.mixture import mixed_loss
from sfsnet_dr.loss.terms import LossWeights
from sfsnet_dr.model.outputs import Decomposition
from sfsnet_dr.model.sfsnet import SfSNet
from sfsnet_dr.model.weights import read_metadata, save_weights
from sfsnet_dr.render.shading_torch import f_render
from sfsnet_dr.study.evaluate.choose import Wanted, methods_for
from sfsnet_dr.study.evaluate.collect import Amount, collect
from sfsnet_dr.study.evaluate.measure import measure
from sfsnet_dr.study.evaluate.run import evaluate
from sfsnet_dr.study.evaluate.shots import Collection, Shot
from sfsnet_dr.study.evaluate.summary import normal_statistics
from sfsnet_dr.study.evaluate.unseen import strangers, told, unseen

SUBJECTS = tuple(f"a{number}" for number in range(1, 7))
SIZE = 16
RECIPE = Recipe(
    steps=4,
    batch_size=4,
    checkpoint_every=2,
    model=ModelRecipe(stem=4, features=8, blocks=1),
    data=Augmentation(lights=4, size=SIZE),
    surfaces=SurfaceOptions(share=0.5, folds=2),
    compute=ComputeRecipe(precision="float32", loss_backend="torch"),
)


def face(subject: str, size: int = SIZE) -> SurfaceLabels:
    """A grey bent surface whose pictures are what its labels render, order-2 light and all."""
    generator = torch.Generator().manual_seed(SUBJECTS.index(subject))
    normal = 0.3 * torch.randn(3, size, size, generator=generator)
    normal[2] = 1
    normal = normal / normal.norm(dim=0)
    albedo = 0.2 + 0.2 * torch.rand(1, size, size, generator=generator)
    direction = torch.tensor([[0.0, 0.0, 1.0], [0.5, 0.0, 0.8], [-0.4, 0.3, 0.8], [0.1, -0.5, 0.8]])
    direction = direction / direction.norm(dim=1, keepdim=True)
    gain = torch.tensor([1.0, 0.5, 1.2, 0.8])
    light = torch.from_numpy(light_labels(direction.numpy(), gain.numpy())).float()
    image = f_render(normal.expand(4, -1, -1, -1), albedo.expand(4, 3, -1, -1), light)[:, :1]
    mask = torch.ones(1, size, size)
    mask[:, :2] = 0
    return SurfaceLabels(
        name=subject, subject=subject, lights=tuple("abcd"), files=tuple("abcd"), image=image,
        normal=normal, albedo=albedo, mask=mask, confidence=0.5 + 0.5 * mask, residual=0 * mask,
        direction=direction, gain=gain,
    )  # fmt: skip


def write_faces(folder: Path, subjects: tuple[str, ...] = SUBJECTS, size: int = SIZE) -> Path:
    folder.mkdir(parents=True)
    rows = {name: {"subject": name, "sha256": write_surface(folder, face(name, size))} for name in subjects}
    write_index(folder, "balls", {"oblique": 0.0, "strength": {}}, rows, {})
    return folder


@pytest.fixture(scope="module")
def surfaces(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_faces(tmp_path_factory.mktemp("labels") / "a")


@pytest.fixture(scope="module")
def spheres(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_spheres(tmp_path_factory.mktemp("faces"), 3)


def test_flips_and_exposure_keep_labels_and_pictures_together() -> None:
    faces = SurfaceFaces([face(name) for name in SUBJECTS], 8, SurfaceOptions(exposure=1.0), seed=0)
    for step in range(3):
        batch, confidence = faces.batch(step)
        drawn = f_render(batch.normal, batch.albedo, batch.light)
        kept = batch.image < 0.999  # what is brighter is clipped, as a camera does
        assert float((drawn - batch.image)[kept].abs().max()) < 2e-3  # kept as halves
        assert float((drawn.roll(1, 0) - batch.image).abs().mean()) > 0.02
        assert (batch.image[:, :1] == batch.image).all()
        assert (batch.light[:, :9] == batch.light[:, 9:18]).all()
        assert confidence.min() == 0.5
    turned = SurfaceFaces([face("a1")], 4, SurfaceOptions(flip=1.0, exposure=0.0), seed=0).batch(0)[0]
    plain = SurfaceFaces([face("a1")], 4, SurfaceOptions(flip=0.0, exposure=0.0), seed=0).batch(0)[0]
    torch.testing.assert_close(turned.image.flip(-1), plain.image, rtol=1e-5, atol=1e-6)
    assert torch.equal(turned.normal[:, 0].flip(-1), -plain.normal[:, 0])


def test_batches_are_functions_of_the_step_and_see_every_picture() -> None:
    faces = [face(name) for name in SUBJECTS[:2]]
    first, second = (SurfaceFaces(faces, 4, SurfaceOptions(), seed=3) for _ in range(2))
    assert torch.equal(first.batch(5)[0].image, second.batch(5)[0].image)
    assert sorted(first.names(0) + first.names(1)) == sorted(f"{f.name}: {x}" for f in faces for x in "abcd")
    halves = [first.batch(2, rank, 2)[0].image for rank in range(2)]
    torch.testing.assert_close(torch.cat(halves), first.batch(2)[0].image)


@given(
    st.sets(st.text("abcxyz0123456789", min_size=1, max_size=8), min_size=2, max_size=40),
    st.integers(2, 6),
    st.integers(0, 5),
)
@settings(max_examples=60, deadline=None)
def test_a_split_never_leaks(names: set[str], folds: int, fold: int) -> None:
    options = SurfaceOptions(share=0.5, folds=folds, fold=fold % folds)
    try:
        split = split_subjects(names, options, "x")
    except BadInput:
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
        options = SurfaceOptions(share=0.5, folds=2, fold=fold)
        faces, split = load_learnt(surfaces, options, View(8))
        batches = SurfaceFaces(faces, 4, options, seed=0)
        assert batches.pixels == (8, 8)
        names = {name.split(":")[0] for step in range(12) for name in batches.names(step)}
        assert names == set(split.learnt)
        assert not names & set(split.held_back)
        seen |= set(split.held_back)
    assert seen == set(SUBJECTS)


def test_albedo_and_light_count_up_to_a_factor(surfaces: Path) -> None:
    batch, confidence = SurfaceFaces([face("a2")], 4, SurfaceOptions(), seed=0).batch(0)
    true = Decomposition(batch.normal, 3 * batch.albedo, batch.light / 3)
    both = Decomposition(*(torch.cat([part, part]) for part in true))
    labelled = FaceBatch(batch.image, *true, batch.mask)
    weights = LossWeights()
    free = MixedBatch(labelled, batch, confidence, free_scale=True)
    _, _, terms = mixed_loss(both, free, weights, weights, "torch")
    assert float(terms.albedo) < 1e-6
    assert float(terms.light) < 1e-9
    _, _, fixed = mixed_loss(both, free._replace(free_scale=False), weights, weights, "torch")
    assert float(fixed.albedo) > 0.1


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

        patch.setattr("sfsnet_dr.fit.run.training_step", step)
        with pytest.raises(RuntimeError):
            train(RECIPE, spheres, tmp_path / "cut", surfaces=surfaces, start=start, progress=False)
    cut = train(
        RECIPE, spheres, tmp_path / "cut", surfaces=surfaces, start=start, resume=True, progress=False
    )
    assert cut.weights.read_bytes() == whole.weights.read_bytes()
    split = read_split(read_metadata(whole.weights))
    assert split == split_subjects(SUBJECTS, RECIPE.surfaces, "balls")
    other = replace(RECIPE, surfaces=replace(RECIPE.surfaces, fold=1))
    with pytest.raises(BadInput, match=r"has learnt from .*, whom this fold holds back"):
        train(other, spheres, tmp_path / "o", surfaces=surfaces, start=whole.weights, progress=False)


def tuned(folder: Path, learnt: tuple[str, ...], lamps_by: str = "") -> Path:
    """Weights that say that they have learnt from some subjects."""
    torch.manual_seed(0)
    held = tuple(name for name in SUBJECTS if name not in learnt)
    split = IdentitySplit("balls", 4, 1, learnt, held, lamps_by)
    path = folder / "ft.safetensors"
    save_weights(path, SfSNet(2, 2, 1), {"recipe": {"data": {"size": 32}}, "surfaces": split.metadata})
    return path


def test_nobody_learnt_from_is_left_for_a_fine_tuned_network(tmp_path: Path) -> None:
    shots = [
        Shot(f"{name}{k}", name, name, torch.zeros(3, 4, 4), torch.zeros(1, 4, 4), np.ones((4, 4)))
        for name in SUBJECTS
        for k in range(4)
    ]
    collection = Collection("balls", shots, "")
    methods, _ = methods_for(shots, Wanted(("flat",), (tuned(tmp_path, SUBJECTS[:4]),)))
    assert [method.name for method in methods] == ["flat", "ft-fold1of4"]
    assert unseen(methods[:1], collection) is collection
    assert unseen(methods, collection).subjects == list(SUBJECTS[4:])
    [note] = told(methods, collection)
    assert "measured on a5, a6 only: 8 of 24 photographs" in note
    methods, _ = methods_for(shots, Wanted(("flat",), (tuned(tmp_path, SUBJECTS),)))
    with pytest.raises(BadInput, match="nobody is left to measure on"):
        unseen(methods, collection)


def test_a_network_that_was_told_no_truth_is_measured_on_everybody(tmp_path: Path) -> None:
    collection = collect("labels", [write_faces(tmp_path / "labels", size=128)], Amount())
    path = tuned(tmp_path, SUBJECTS[:4], lamps_by="skipnet")
    methods, _ = methods_for(collection.shots, Wanted(("flat",), (path,)))
    assert [method.name for method in methods] == ["flat", "ft"]
    assert unseen(methods, collection) is collection
    [note] = told(methods, collection)
    assert "from pictures of 4 of the 6 subjects without being told" in note
    assert "ft-strangers: the same network on a5, a6" in note
    found = measure(methods[1], collection.shots)
    assert strangers(methods[0], found) is None
    apart = strangers(methods[1], found)
    assert apart is not None
    assert apart.method == "ft-strangers"
    assert {errors.shot.subject for errors in apart.images} == set(SUBJECTS[4:])
    records = {record.what: record.value for record in evaluate(collection, methods, tmp_path / "out", "")}
    pooled = normal_statistics(apart.images)["mean_deg"]
    assert records["balls.ft_strangers.normals.mean_deg"] == pytest.approx(pooled)
    assert records["balls.ft.normals.mean_deg"] != records["balls.ft_strangers.normals.mean_deg"]
    assert "ft-strangers" in (tmp_path / "out" / "index.html").read_text()
    methods, _ = methods_for(collection.shots, Wanted(("flat",), (tuned(tmp_path, SUBJECTS, "skipnet"),)))
    assert strangers(methods[1], found) is None


@pytest.mark.slow
def test_evaluation_measures_on_held_back_subjects_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    collection = collect("labels", [write_faces(tmp_path / "labels", size=128)], Amount())
    methods, _ = methods_for(collection.shots, Wanted(("flat",), (tuned(tmp_path, SUBJECTS[:4]),)))
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


def test_bad_fine_tunings_are_told(surfaces: Path, spheres: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"surfaces: 1 subject found, two are needed"):
        load_learnt(write_faces(tmp_path / "one", SUBJECTS[:1]), RECIPE.surfaces)
    alike = [n for n in (f"p{k}" for k in range(40)) if fold_of(n, 2) == 0]
    with pytest.raises(BadInput, match=r"all of .* subjects would be held back by fold 0 of 2"):
        split_subjects(alike, SurfaceOptions(folds=2), "x")
    with pytest.raises(BadInput, match=r"none of .* subjects would be held back by fold 1 of 2"):
        split_subjects(alike, SurfaceOptions(folds=2, fold=1), "x")
    with pytest.raises(BadInput, match=r"surfaces\.fold: 4 found, 0 to 3 allowed"):
        SurfaceOptions(fold=4)
    with pytest.raises(BadInput, match=r"surfaces\.share: 0\.5 in the recipe and no folder of labels"):
        train(RECIPE, spheres, tmp_path / "out", progress=False)
    with pytest.raises(BadInput, match="one kind of real faces"):
        replace(RECIPE, real=RealOptions(share=0.25))
    with pytest.raises(BadInput, match="'display' found, 'linear' is needed"):
        replace(RECIPE, real=RealOptions(values="display"))
    with pytest.raises(BadInput, match=r"16 x 16 pixels found, a square of 22 .*; see data\.size"):
        load_learnt(surfaces, RECIPE.surfaces, View(16, 96))
    older = write_faces(tmp_path / "older", SUBJECTS[:2])
    index = json.loads((older / "surfaces.json").read_text()) | {"format": "sfsnet_dr.surfaces.0"}
    (older / "surfaces.json").write_text(json.dumps(index))
    with pytest.raises(BadInput, match=r"format 'sfsnet_dr\.surfaces\.0' found"):
        load_learnt(older, RECIPE.surfaces)
    (tmp_path / "r.toml").write_text("steps = 1\n[surfaces]\nfoldz = 3\n")
    with pytest.raises(BadInput, match="unknown key 'foldz'"):
        read_recipe(tmp_path / "r.toml")


@pytest.mark.parametrize("kind", ["small", "full"])
def test_the_recipes_are_read(kind: str) -> None:
    recipe = read_recipe(Path(__file__).parents[1] / "training" / "recipes" / kind / "sfsnet-ft.toml")
    assert recipe.surfaces.share == 0.5
