"""Batches of rendered and real faces: the same for the same step, flipped as a whole, weighted as told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.dataset import RelitFaces, load_faces
from sfsnet_dr.data.mixed_batch import MixedBatch, MixedFaces, PseudoLabelOptions, RealBatch, RealFaces
from sfsnet_dr.data.pseudo_labels import Encoding, LabelFolder, PseudoFaces, encode_labels, load_pseudo_labels
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.losses.sfsnet import LossWeights, mixed_loss, sfsnet_loss
from sfsnet_dr.models.base import NetworkOutput
from sfsnet_dr.render.shading_torch import f_render
from sfsnet_dr.train.config import ComputeRecipe, ModelRecipe, Recipe
from sfsnet_dr.train.logging import read_history
from sfsnet_dr.train.step import training_step
from sfsnet_dr.train.trainer import train

RECIPE = Recipe(
    steps=6,
    batch_size=4,
    checkpoint_every=3,
    model=ModelRecipe(stem=4, features=8, blocks=1),
    data=Augmentation(num_lights=4),
    real=PseudoLabelOptions(batch_fraction=0.5),
    compute=ComputeRecipe(precision="float32", loss_backend="torch"),
)


def write_labels(folder: Path, count: int = 5, size: int = 16, values: Encoding = "linear") -> Path:
    """Photographs that their own labels render exactly, up to the rounding of both."""
    folder.mkdir()
    generator = torch.Generator().manual_seed(3)
    normal = torch.randn(count, 3, size, size, generator=generator) * 0.4
    normal[:, 2] = 1
    normal = normal / normal.norm(dim=1, keepdim=True)
    albedo = 0.2 + 0.5 * torch.rand(count, 3, size, size, generator=generator)
    light = 0.15 * torch.randn(count, 27, generator=generator)
    light[:, ::9] = 2.5
    picture = f_render(normal, albedo, light).clamp(0, 1)
    if values == "linear":
        from sfsnet_dr.core.color_torch import linear_to_srgb

        picture = linear_to_srgb(picture)
    mask = torch.full((count, 1, size, size), 255, dtype=torch.uint8)
    confidence = torch.rand(count, 1, size, size, generator=generator)
    image = (picture * 255).round().to(torch.uint8)
    target = LabelFolder(folder, {"values": values, "size": size})
    names = [f"{number}.jpg" for number in range(count)]
    target.write(0, encode_labels(image, mask, confidence, normal, albedo, light), names, names, {})
    target.finish(1, [], {})
    return folder


@pytest.fixture(scope="module")
def labels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five labelled photographs of 16 x 16."""
    return write_labels(tmp_path_factory.mktemp("labels") / "a")


def misfit(batch: FaceBatch) -> float:
    """Mean difference between the images of a batch and what its labels render."""
    return float((f_render(batch.normal, batch.albedo, batch.light) - batch.image).abs().mean())


@pytest.mark.parametrize("values", ["linear", "srgb"])
def test_flips_and_exposure_keep_labels_and_photographs_together(values: Encoding, tmp_path: Path) -> None:
    """Whatever happens to a photograph, its labels still render it: 8-bit rounding leaves 0.006 at most."""
    faces = load_pseudo_labels(write_labels(tmp_path / "labels", values=values))
    options = PseudoLabelOptions(flip=0.5, exposure_stops=2.0, encoding=values)
    real = RealFaces(faces, 4, options, seed=0)
    for step in range(3):
        batch = real.batch(step).faces
        assert misfit(batch) < 0.006
        assert misfit(batch._replace(light=batch.light.roll(1, 0))) > 0.02  # the check would see a mistake


def test_batches_are_functions_of_the_step(labels: Path, spheres: Path) -> None:
    faces, real = load_faces(spheres), load_pseudo_labels(labels)

    def mixed(seed: int) -> MixedFaces:
        rendered = RelitFaces(faces, 2, Augmentation(num_lights=4), seed)
        return MixedFaces(rendered, RealFaces(real, 2, PseudoLabelOptions(batch_fraction=0.5), seed))

    first, second = mixed(0), mixed(0)
    for step in (3, 0):  # in any order
        assert same(first.batch(step), second.batch(step))
    assert not same(first.batch(0), first.batch(1))
    assert not same(first.batch(0), mixed(1).batch(0))
    assert first.fingerprint == second.fingerprint
    assert len(first.names(0)) == 4
    assert first.batch(0).image.shape == (4, 3, 16, 16)
    epoch = [name for step in range(5) for name in RealFaces(real, 1, PseudoLabelOptions(), 0).names(step)]
    assert sorted(epoch) == sorted(real.names)


def same(a: MixedBatch, b: MixedBatch) -> bool:
    """Equal to the bit."""
    pairs = [*zip(a.labelled, b.labelled, strict=True), *zip(a.real.faces, b.real.faces, strict=True)]
    return all(torch.equal(x, y) for x, y in [*pairs, *zip(a.real[1:], b.real[1:], strict=True)])


def guess(batch: MixedBatch) -> NetworkOutput:
    """An answer that is off by a tenth in everything."""
    parts: list[Tensor] = [
        torch.cat([x, y]) + 0.1
        for x, y in zip(batch.labelled[1:4], batch.real.faces[1:4], strict=True)
    ]  # fmt: skip
    return NetworkOutput(*parts)


def test_the_loss_is_the_mean_over_faces_and_trusts_as_told(labels: Path, spheres: Path) -> None:
    rendered = RelitFaces(load_faces(spheres), 3, Augmentation(num_lights=4), 0)
    real = RealFaces(load_pseudo_labels(labels), 1, PseudoLabelOptions(batch_fraction=0.25), 0)
    batch = MixedFaces(rendered, real).batch(0)
    weights, real_weights = LossWeights(), LossWeights(recon=2.0, normal=1.0)
    total, first, second = mixed_loss(guess(batch), batch, weights, real_weights, "torch")
    assert float(total) == pytest.approx((3 * float(first.total) + float(second.total)) / 4)
    only = NetworkOutput(*(part[:3] for part in guess(batch)))
    assert torch.equal(first.total, sfsnet_loss(only, batch.labelled, weights, "torch").total)
    # Errors of 0.1 everywhere, so the weighted means follow from the mean confidence alone.
    mask = batch.real.faces.mask
    trust = float((mask * batch.real.confidence).sum() / mask.sum())
    assert float(second.normal) == pytest.approx(0.1 * trust, rel=1e-4)
    assert float(second.albedo) == pytest.approx(0.1 * trust, rel=1e-4)
    assert float(second.light) == pytest.approx(0.01 * trust, rel=1e-4)
    nothing = [torch.zeros_like(batch.real.confidence), batch.real.free_scale, torch.zeros(1)]
    blind = batch._replace(real=RealBatch(batch.real.faces, *nothing))
    _, _, without = mixed_loss(guess(blind), blind, weights, real_weights, "torch")
    assert float(without.normal) == float(without.light) == 0
    assert torch.equal(without.recon, second.recon)


def test_a_mixed_run_is_resumed_to_the_bit(
    labels: Path, spheres: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sfsnet_dr.train.step.STEPS", 5)  # and what the watch saw is remembered with it
    monkeypatch.setattr("sfsnet_dr.train.step.SMALLEST", 1e6)
    whole = train(RECIPE, spheres, tmp_path / "whole", labels=labels, progress=False)
    assert {"real_recon", "real_normal", "real_albedo", "real_light"} <= set(whole.final)
    with monkeypatch.context() as patch:
        calls = iter(range(5))

        def step(*arguments: Any) -> dict[str, float]:
            if next(calls) == 4:
                raise RuntimeError("power cut")
            return training_step(*arguments)

        patch.setattr("sfsnet_dr.train.run.training_step", step)
        with pytest.raises(RuntimeError):
            train(RECIPE, spheres, tmp_path / "cut", labels=labels, progress=False)
    cut = train(RECIPE, spheres, tmp_path / "cut", labels=labels, resume=True, progress=False)
    assert cut.weights.read_bytes() == whole.weights.read_bytes()
    told = [[line["step"] for line in read_history(run.history) if "warning" in line] for run in (whole, cut)]
    assert told == [[4], [4]]


def other_size(folder: Path) -> PseudoFaces:
    return load_pseudo_labels(write_labels(folder / "labels", 2, size=8))


def test_bad_mixtures_are_told(labels: Path, spheres: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"real\.batch_fraction: 0\.1 of 4 images is 0"):
        replace(RECIPE, real=PseudoLabelOptions(batch_fraction=0.1))
    with pytest.raises(InputError, match=r"real\.batch_fraction: 1\.5 found, 0 to 1 allowed"):
        PseudoLabelOptions(batch_fraction=1.5)
    with pytest.raises(InputError, match=r"real\.batch_fraction: 0\.5 in the recipe and no folder of labels"):
        train(RECIPE, spheres, tmp_path / "out", progress=False)
    with pytest.raises(InputError, match=r"real\.batch_fraction: 0 in the recipe and the labels of"):
        train(
            replace(RECIPE, real=PseudoLabelOptions()),
            spheres,
            tmp_path / "out",
            labels=labels,
            progress=False,
        )
    with pytest.raises(InputError, match="'srgb' found, the pseudo-labels were made with 'linear'"):
        RealFaces(load_pseudo_labels(labels), 2, PseudoLabelOptions(encoding="srgb"), 0)
    rendered = RelitFaces(load_faces(spheres), 2, Augmentation(num_lights=4), 0)
    with pytest.raises(InputError, match=r"8 x 8 pixels found, 16 x 16"):
        MixedFaces(rendered, RealFaces(other_size(tmp_path), 2, PseudoLabelOptions(), 0))
    other = tmp_path / "other"
    other.mkdir()
    (other / "manifest.json").write_text(json.dumps({"format": "sfsnet_dr.pseudo_labels.9"}))
    (other / "labels.json").write_text("{}")
    with pytest.raises(InputError, match=r"format 'sfsnet_dr\.pseudo_labels\.9' found"):
        load_pseudo_labels(other)
