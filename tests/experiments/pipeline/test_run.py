"""All stages of training in one command: each runs once, goes on where it was stopped, and is measured."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from data.test_photos import write_photos
from helpers.spheres import write_spheres
from rich.console import Console
from torch import Tensor

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.visualize import png_bytes
from sfsnet_dr.data.dataset import load_faces
from sfsnet_dr.data.photos import PhotoSet
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.experiments.pipeline.config import NETWORKS, read_plan
from sfsnet_dr.experiments.pipeline.holdout_split import (
    holdout_batch,
    photograph_errors,
    reconstruction_errors,
    rendered_errors,
)
from sfsnet_dr.experiments.pipeline.run import run_stages
from sfsnet_dr.metrics.image import mae_8bit, rmse_8bit
from sfsnet_dr.models.base import Network, NetworkOutput
from sfsnet_dr.models.inference import LoadedModel, mirror_output
from sfsnet_dr.render.shading_torch import f_render
from sfsnet_dr.report.record import read_records
from sfsnet_dr.train.trainer import train

RECIPE = """
steps = 2
batch_size = 2
[model]
{model}
[data]
size = 32
num_val = 2
num_lights = 4
[data.light]
directional = 1.0
sun_sky = 0.0
studio = 0.0
[real]
batch_fraction = {share}
[compute]
loss_backend = "torch"
"""
MODELS = {
    "skipnet-syn": ('architecture = "skipnet"\nwidth = 2', 0),
    "sfsnet": ("stem = 2\nfeatures = 4\nblocks = 1", 0.5),
    "sfsnet-syn": ("stem = 2\nfeatures = 4\nblocks = 1", 0),
    "skipnet-plus": ('architecture = "skipnet-plus"\nwidth = 2', 0.5),
}


def write_set(folder: Path, **more: int) -> Path:
    """A set of stages with recipes that take no time."""
    (folder / "recipes").mkdir(parents=True)
    for name, (model, share) in MODELS.items():
        (folder / "recipes" / f"{name}.toml").write_text(RECIPE.format(model=model, share=share))
    values = {"photographs": 3, "num_val": 2, "pictures": 3} | more
    lines = [f"{key} = {value}" for key, value in values.items()]
    (folder / "set.toml").write_text("\n".join(['recipes = "recipes"', *lines]))
    return folder / "set.toml"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five spheres of 32 x 32."""
    return write_spheres(tmp_path_factory.mktemp("faces"), 5, size=32)


def quiet() -> Console:
    return Console(quiet=True)


def counted(monkeypatch: pytest.MonkeyPatch, stop_at: int | None = None) -> list[Path]:
    """Folders that networks are trained in from now on; one training may be cut off before it begins."""
    folders: list[Path] = []

    def training(recipe: Any, faces: Any, folder: Path, **more: Any) -> object:
        if len(folders) == stop_at:
            raise KeyboardInterrupt
        folders.append(folder)
        return train(recipe, faces, folder, progress=False, **more)

    monkeypatch.setattr("sfsnet_dr.experiments.pipeline.cache.train", training)
    return folders


def test_all_stages_run_once_and_are_measured(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_set(tmp_path / "set")
    out = tmp_path / "out"
    plan = read_plan(path, out, data=[data], rendered_photographs=True)
    with monkeypatch.context() as patch:
        begun = counted(patch, stop_at=1)
        with pytest.raises(KeyboardInterrupt):
            run_stages(plan, command="", console=quiet())
        assert [folder.name for folder in begun] == ["skipnet-syn"]
    again = counted(monkeypatch)
    records = run_stages(plan, command="sfsnet-dr train-all", console=quiet())
    assert [folder.name for folder in again] == list(NETWORKS[1:])
    what = {record.what: record for record in records}
    for name in NETWORKS:
        assert 0 < what[f"synthetic.normals.mean_deg.{name}"].value < 180
        assert what[f"stand_ins.recon.rmse.{name}"].value >= what[f"stand_ins.recon.mae.{name}"].value > 0
        assert what[f"synthetic.albedo.mae.{name}"].interval is not None
    assert not any(name.startswith("photographs.") for name in what), "rendered faces are no photographs"
    assert what["pseudo_label.labelled"].value == 3
    assert read_records(out / "records.json") == records
    page = (out / "index.html").read_text(encoding="utf-8")
    assert "rendered faces stood in for them" in page
    for name in NETWORKS:
        assert f'id="{name}"' in page

    monkeypatch.setattr("sfsnet_dr.experiments.pipeline.run.write_results", lambda *_: [])
    run_stages(plan, command="", console=quiet())
    assert len(again) == 3, "nothing is trained twice"
    recipe = path.parent / "recipes" / "sfsnet-syn.toml"
    recipe.write_text(recipe.read_text().replace("steps = 2", "steps = 3"))
    with pytest.raises(
        InputError, match=r"recipe\.steps = 2 found, 3 asked for; choose another --out, or remove"
    ):
        run_stages(read_plan(path, out, data=[data], rendered_photographs=True), command="", console=quiet())


def test_photographs_are_measured_under_their_own_name(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted(monkeypatch)
    dot = png_bytes(np.zeros((1, 1, 3), np.uint8))
    for drawing in ("draw_sheet", "loss_curve"):  # the test above draws them
        monkeypatch.setattr(f"sfsnet_dr.experiments.pipeline.page.{drawing}", lambda *_, **__: dot)
    photographs = write_photos(tmp_path / "photographs", 6)
    plan = read_plan(write_set(tmp_path / "set"), tmp_path / "out", data=[data], photographs=photographs)
    what = {record.what: record.value for record in run_stages(plan, command="", console=quiet())}
    assert what["photographs.recon.mae.sfsnet"] > 0
    assert what["pseudo_label.labelled"] == 3
    labels = json.loads((tmp_path / "out" / "pseudo-label" / "manifest.json").read_text())
    assert len(labels["held_back"]) == 2


def test_a_set_that_cannot_run_is_refused_before_anything_is_done(data: Path, tmp_path: Path) -> None:
    path, out = write_set(tmp_path / "set"), tmp_path / "out"
    with pytest.raises(
        InputError, match="photographs are needed by pseudo-label, sfsnet and skipnet-plus: neither"
    ):
        read_plan(path, out, data=[data])
    with pytest.raises(InputError, match="both were given"):
        read_plan(path, out, photographs=tmp_path, rendered_photographs=True)
    with pytest.raises(InputError, match="no such folder; a folder of photographs"):
        run_stages(
            read_plan(path, out, data=[data], photographs=tmp_path / "no"), command="", console=quiet()
        )
    assert list(out.iterdir()) == []
    recipe = path.parent / "recipes" / "sfsnet.toml"
    recipe.write_text(recipe.read_text().replace("size = 32", "size = 16"))
    with pytest.raises(InputError, match=r"sfsnet\.toml: data\.size = 16 found, 32 as in skipnet-syn\.toml"):
        read_plan(path, out, data=[data], rendered_photographs=True)
    path.write_text('recipes = "recipes"\npicturez = 3\n')
    with pytest.raises(InputError, match="unknown key 'picturez'; did you mean 'pictures'"):
        read_plan(path, out, data=[data], rendered_photographs=True)
    path.write_text('recipes = "recipes"\nnum_val = 0\n')
    with pytest.raises(InputError, match="num_val: 0 found"):
        read_plan(path, out, data=[data], rendered_photographs=True)


def test_held_back_faces_are_not_trained_on(data: Path, tmp_path: Path) -> None:
    train_faces, held = (load_faces(data, held_back=2, held=kind) for kind in (False, True))
    assert len(train_faces) == 3
    assert len(held) == 2
    assert set(train_faces.names).isdisjoint(held.names)
    assert train_faces.fingerprint != held.fingerprint
    other = write_spheres(tmp_path / "other", 1, size=32)
    both = load_faces([data, other])
    assert len(both) == 6
    assert both.names[-1] == "other/sphere_000.exr"
    with pytest.raises(InputError, match=r"data\.num_val: 3 of 5 bundles found, less than half"):
        load_faces(data, held_back=3)


class Oracle(Network):
    """Answers with what it was told, whatever it is shown."""

    architecture = "oracle"
    multiple = 1

    def __init__(self, answer: NetworkOutput) -> None:
        super().__init__({})
        self.answers = itertools.cycle([answer, mirror_output(answer)])

    def forward(self, image: Tensor) -> NetworkOutput:
        return next(self.answers)  # it is asked for images and then for their mirror images


def trained(answer: NetworkOutput) -> LoadedModel:
    return LoadedModel(Oracle(answer), Crop(32), "linear", {})


def test_errors_are_those_of_the_answer(data: Path) -> None:
    truth = holdout_batch(load_faces(data), Augmentation(num_lights=4), 4)
    right = NetworkOutput(truth.normal, truth.albedo, truth.light)
    numbers = rendered_errors(trained(right), truth)
    for name in ("normals.mean_deg", "albedo.mae", "light.relative"):
        np.testing.assert_allclose(numbers[name], 0, atol=1e-4)
    angle = torch.deg2rad(torch.tensor(25.0))
    x, y, z = truth.normal.unbind(1)
    turned = torch.stack([x * angle.cos() + z * angle.sin(), y, z * angle.cos() - x * angle.sin()], 1)
    # Turned about y, a normal moves by 25 degrees times its distance from that axis, at most.
    wrong = NetworkOutput(turned, 0.8 * truth.albedo, 1.5 * truth.light)
    numbers = rendered_errors(trained(wrong), truth)
    assert np.all((numbers["normals.mean_deg"] > 15) & (numbers["normals.mean_deg"] < 25))
    assert np.all(numbers["normals.below30"] == 100)
    inside = truth.mask.sum((1, 2, 3)) * 3
    expected = 0.2 * (truth.mask * truth.albedo).sum((1, 2, 3)) / inside
    np.testing.assert_allclose(numbers["albedo.mae"], expected, rtol=1e-5)
    np.testing.assert_allclose(numbers["albedo.mae_scaled"], 0, atol=1e-5)
    np.testing.assert_allclose(numbers["light.relative"], 0.5, rtol=1e-5)


@pytest.mark.parametrize("values", ["linear", "srgb"])
def test_reconstruction_is_the_metric_of_one_image(values: Any) -> None:
    generator = torch.Generator().manual_seed(0)
    answer = NetworkOutput(
        torch.nn.functional.normalize(torch.randn(2, 3, 8, 8, generator=generator), dim=1),
        torch.rand(2, 3, 8, 8, generator=generator),
        torch.randn(2, 27, generator=generator),
    )
    image, mask = torch.rand(2, 3, 8, 8, generator=generator), torch.rand(2, 1, 8, 8, generator=generator)
    found = reconstruction_errors(answer, image, mask, values)
    rendered = f_render(*answer)
    for index in range(2):
        a, b = (part[index].permute(1, 2, 0).double().numpy() for part in (rendered, image))
        if values == "linear":
            mae, rmse = mae_8bit(a, b, mask[index, 0].numpy()), rmse_8bit(a, b, mask[index, 0].numpy())
        else:
            difference, weight = 255 * (np.clip(a, 0, 1) - b), mask[index, 0].numpy()[..., None]
            mae, rmse = (
                float(((weight * abs(difference) ** power).sum() / (3 * weight.sum())) ** (1 / power))
                for power in (1, 2)
            )
        # colour-science's curve and torch's, in single precision
        assert found["recon.mae"][index] == pytest.approx(mae, rel=1e-4)
        assert found["recon.rmse"][index] == pytest.approx(rmse, rel=1e-4)


def test_display_referred_networks_see_photographs_as_their_files_have_them() -> None:
    seen: list[Tensor] = []
    images = torch.randint(0, 256, (2, 3, 32, 32), dtype=torch.uint8)
    photographs = PhotoSet(images, torch.full((2, 1, 32, 32), 255, dtype=torch.uint8), ("a", "b"), (), ())
    answer = NetworkOutput(torch.ones(2, 3, 32, 32), images.float() / 255, torch.zeros(2, 27))
    answer.light[:, ::9] = (4 * torch.pi) ** 0.5  # shading 1
    model = Oracle(answer)
    model.register_forward_pre_hook(lambda _m, given: seen.append(given[0]))
    numbers = photograph_errors(LoadedModel(model, Crop(32), "srgb", {}), photographs)
    torch.testing.assert_close(seen[0], images.float() / 255)
    np.testing.assert_allclose(numbers["recon.mae"], 0, atol=1e-3)
    assert (
        photograph_errors(LoadedModel(model, Crop(32), "linear", {}), photographs)["recon.mae"] > 10
    ).all()


@pytest.mark.slow
def test_the_optional_stage_fine_tunes_and_measures_on_held_back_subjects(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from helpers.captures import SUBJECTS, write_faces

    path = write_set(tmp_path / "set")
    text = RECIPE.format(model=MODELS["sfsnet"][0], share=0) + "[surfaces]\nshare = 0.5\nfolds = 2\n"
    (tmp_path / "set" / "recipes" / "sfsnet-ft.toml").write_text(text)
    surfaces = write_faces(tmp_path / "labels", size=128)
    plan = read_plan(path, tmp_path / "out", data=[data], rendered_photographs=True, surfaces=surfaces)
    # Of the stages before it only SfSNet's weights are needed.
    monkeypatch.setattr("sfsnet_dr.experiments.pipeline.run.NETWORKS", ("skipnet-syn", "sfsnet"))
    monkeypatch.setattr("sfsnet_dr.experiments.pipeline.run.write_results", lambda *_: [])
    records = run_stages(plan, command="", console=quiet())
    names = {record.what for record in records}
    assert {f"balls.{name}.normals.mean_deg" for name in ("sfsnet", "sfsnet_ft_fold0of2")} <= names
    [held] = [record.value for record in records if record.what == "balls.subjects"]
    assert 0 < held < len(SUBJECTS)
    notes = json.loads((tmp_path / "out" / "sfsnet-ft" / "stage.json").read_text())
    assert notes["start"] is not None
