"""The protocols of the evaluation against cases whose answers are known by hand."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.look_alikes import ANGLES, write_yale_b
from torch import Tensor

from sfsnet_dr.cli.main import main
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.normal_labels import NormalLabels, light_labels
from sfsnet_dr.experiments.evaluation.labelled import labelled_samples
from sfsnet_dr.experiments.evaluation.measure import measure_methods, scaled_rms
from sfsnet_dr.experiments.evaluation.page import merge_equal_methods
from sfsnet_dr.experiments.evaluation.records import evaluation_records, normal_statistics
from sfsnet_dr.experiments.evaluation.samples import Collection
from sfsnet_dr.inference.baselines import MeanAlbedo, MeanNormals, OneAlbedo
from sfsnet_dr.inference.methods import FlatNormals, Prediction, fit_light_and_albedo
from sfsnet_dr.metrics.light import class_ranks, light_direction
from sfsnet_dr.models.sfsnet import SfSNet
from sfsnet_dr.models.weights import save_weights
from sfsnet_dr.render.shading_torch import shading


def tilted(degrees: float, size: int = 4) -> Tensor:
    """Normals (3, size, size) turned to the right."""
    angle = np.radians(degrees)
    normal = torch.zeros(3, size, size)
    normal[0], normal[2] = float(np.sin(angle)), float(np.cos(angle))
    return normal


def face(subject: str, degrees: float, directions: Sequence[Sequence[float]]) -> NormalLabels:
    count, normal = len(directions), tilted(degrees)
    direction = torch.tensor(np.array(directions), dtype=torch.float32)
    return NormalLabels(
        name=subject, subject=subject,
        lights=tuple(f"l{j}" for j in range(count)), files=tuple(f"{j}" for j in range(count)),
        image=torch.full((count, 1, 4, 4), 0.4), normal=normal, albedo=torch.full((1, 4, 4), 0.5),
        mask=torch.ones(1, 4, 4), confidence=torch.ones(1, 4, 4), residual=torch.zeros(1, 4, 4),
        direction=direction, gain=torch.ones(count),
    )  # fmt: skip


def collected(*faces: NormalLabels) -> Collection:
    return labelled_samples("yale-b", faces, {})


FRONT, SIDE, FAR = [0.0, 0.0, 1.0], [0.5, 0.0, 0.866], [0.98, 0.0, 0.199]


def test_normals_are_pooled_over_pixels_and_split_by_the_angle_of_the_light() -> None:
    faces = collected(face("a", 10, [FRONT, SIDE, FAR]), face("b", 26, [FRONT]))
    found = measure_methods(FlatNormals(), faces.shots)
    numbers = normal_statistics(found.images)
    # Three images are off by 10 degrees and one by 26: mean 14, standard deviation sqrt(3 * 16 + 144) / 2.
    assert numbers["mean_deg"] == pytest.approx(14, abs=1e-4)
    assert numbers["std_deg"] == pytest.approx(np.sqrt(48), abs=1e-4)
    assert [numbers[f"below{k}"] for k in (20, 25, 30)] == [75, 75, 100]
    records = {r.what: r for r in evaluation_records(faces, found, "")}
    assert records["yale_b.flat.normals.angle0_12.mean_deg"].value == pytest.approx(18, abs=1e-4)
    assert records["yale_b.flat.normals.angle25_50.mean_deg"].value == pytest.approx(10, abs=1e-4)
    assert records["yale_b.flat.normals.angle77_180.below20"].value == 100
    assert "yale_b.flat.normals.angle50_77.mean_deg" not in records
    ends = records["yale_b.flat.normals.mean_deg"].interval
    # Two identities: the bootstrap draws a alone, b alone or both.
    assert ends == pytest.approx((10, 26), abs=1e-4)


def test_the_mean_face_leaves_the_subject_out() -> None:
    method = MeanNormals({"a": tilted(0), "b": tilted(40), "c": tilted(40)})
    answer = method(torch.full((2, 3, 4, 4), 0.4), torch.ones(2, 1, 4, 4), ["a", "b"])
    assert np.degrees(np.arcsin(answer.normal[0, 0].numpy())) == pytest.approx(40, abs=0.1)
    assert np.degrees(np.arcsin(answer.normal[1, 0].numpy())) == pytest.approx(20, abs=0.1)
    with pytest.raises(InputError, match="two are needed"):
        MeanNormals({"a": tilted(0)})


def test_the_mean_albedo_leaves_the_subject_out_and_takes_each_as_bright_as_the_others() -> None:
    normals = {name: tilted(0) for name in "abc"}
    half = torch.ones(1, 4, 4)
    half[..., :2] = 3.0
    even, unknown = torch.ones(1, 4, 4), half.clone()
    unknown[:, 0] = 0  # half as many pixels say something there
    method = MeanAlbedo(normals, {"a": half, "b": 10 * even, "c": 0.1 * unknown})
    images = torch.full((3, 3, 4, 4), 0.4)
    answer = method(images, torch.ones(3, 1, 4, 4), ["a", "b", "c"])
    assert not answer.divided
    # b is 0.5 everywhere, a and c 0.75 and 0.25 where they are known
    mixed = torch.tensor([0.625, 0.625, 0.375, 0.375])
    torch.testing.assert_close(answer.albedo[0, 0, 1:], mixed.expand(3, 4))
    torch.testing.assert_close(answer.albedo[0, 0, 0], torch.full((4,), 0.5))
    torch.testing.assert_close(answer.albedo[1, 2], torch.tensor([0.75, 0.75, 0.25, 0.25]).expand(4, 4))
    torch.testing.assert_close(answer.albedo[2], mixed.expand(3, 4, 4))


def test_one_albedo_explains_an_evenly_lit_face() -> None:
    images = torch.full((1, 3, 4, 4), 0.4)
    images[:, :, 0] = 0.1
    method = OneAlbedo({"a": tilted(0), "b": tilted(0)})
    masks = torch.ones(1, 1, 4, 4)
    masks[:, :, 0] = 0
    answer = method(images, masks, ["a"])
    torch.testing.assert_close(answer.albedo, torch.full((1, 3, 4, 4), 0.5))
    # all normals are the same, so that only the ridge keeps the image from being explained: 1 % of it
    torch.testing.assert_close(answer.image[:, :, 1:], images[:, :, 1:], atol=0, rtol=0.01)
    with pytest.raises(InputError, match="two are needed"):
        OneAlbedo({"a": tilted(0)})


def test_light_of_a_shaded_ball_is_found_and_explains_it() -> None:
    generator = torch.Generator().manual_seed(0)
    normal = torch.randn(1, 3, 32, 32, generator=generator)
    normal = normal / normal.norm(dim=1, keepdim=True)
    light = torch.tensor(light_labels([[0.3, 0.1, 0.9]], [0.2]), dtype=torch.float32)
    light = light + torch.tensor([0.6] + [0.0] * 8).repeat(3)
    image = 0.5 * shading(normal, light)
    answer = fit_light_and_albedo(normal, image, torch.ones(1, 1, 32, 32), ridge=1e-6)
    torch.testing.assert_close(answer.light, light, atol=1e-3, rtol=0)
    torch.testing.assert_close(answer.image, image, atol=1e-3, rtol=0)


def test_direction_of_light_is_that_of_its_linear_part() -> None:
    direction = np.array([[0.36, -0.48, 0.8], [-0.6, 0.0, 0.8]])
    np.testing.assert_allclose(light_direction(light_labels(direction, [1, 2])), direction, atol=1e-12)
    np.testing.assert_array_equal(light_direction(np.zeros((1, 27))), [[0, 0, 1]])


def test_ranks_of_lights_leave_the_subject_out_and_ignore_the_scale() -> None:
    lights = np.array([[1, 0], [0, 1], [5, 0.1], [0.1, 5], [0, 3], [3, 0]])
    classes, subjects = ["u", "v"] * 3, ["a", "a", "b", "b", "c", "c"]
    # c has the two lights the other way round: its means are those of a and b.
    assert class_ranks(lights, classes, subjects).tolist()[4:] == [2, 2]
    # A subject whose own images took part would find itself: with one odd light each, own means would win.
    odd = [[1, 0], [0, 1], [0, 1], [1, 0]]
    assert class_ranks(odd, ["u", "v", "u", "v"], ["a", "a", "b", "b"]).tolist() == [2, 2, 2, 2]


def test_equal_answers_for_all_images_do_not_score() -> None:
    assert class_ranks(np.ones((4, 3)), ["u", "v"] * 2, ["a", "a", "b", "b"]).tolist() == [2, 2, 2, 2]


def test_a_light_of_one_subject_only_is_refused() -> None:
    with pytest.raises(InputError, match="w was seen with b only"):
        class_ranks(np.eye(3), ["u", "u", "w"], ["a", "b", "b"])


def test_albedo_is_measured_after_the_best_factor() -> None:
    true = np.array([1.0, 2.0, 3.0])
    assert scaled_rms(7 * true, true) == pytest.approx(0)
    assert scaled_rms(np.zeros(3), true) == pytest.approx(1)
    # Best constant for 1, 2, 3 is 2: errors 1, 0, 1 against squares 14.
    assert scaled_rms(np.ones(3), true) == pytest.approx(np.sqrt(2 / 14))


def test_albedo_is_told_apart_where_the_truth_is_sure() -> None:
    """Half of the face is three times as bright, and its truth unsure: a constant errs there alone."""
    plain = face("a", 0, [FRONT])
    bright = torch.ones(1, 4, 4, dtype=torch.bool)
    bright[:, 2:] = False
    unsure = replace(
        plain,
        albedo=torch.where(bright, 1.5, 0.5),
        confidence=torch.where(bright, 0.89, 0.91),
    )
    collection = collected(unsure)
    found = measure_methods(FlatNormals(), collection.shots)
    (errors,) = found.images
    # Best constant for 1 and 3 is 2: errors 1 and 1 against squares 1 and 9.
    assert errors.albedo == pytest.approx(np.sqrt(2 / 10), abs=1e-4)
    assert errors.albedo_confident == pytest.approx(0, abs=1e-4)
    records = {record.what for record in evaluation_records(collection, found, "")}
    assert "yale_b.flat.albedo.confident.scaled_rms" in records
    (nowhere,) = measure_methods(
        FlatNormals(), collected(replace(plain, confidence=0 * plain.mask)).shots
    ).images
    assert nowhere.albedo_confident is None


def test_reconstruction_is_measured_in_8_bit_units() -> None:
    class Black:
        name = "black"

        def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Prediction:
            normal = tilted(0).expand(len(images), -1, -1, -1)
            return Prediction(normal, images, torch.zeros(len(images), 27), torch.zeros_like(images))

    (errors,) = measure_methods(Black(), collected(face("a", 0, [FRONT])).shots).images
    # 0.4 linear is 169.9 of 255 encoded: 255 (1.055 * 0.4^(1/2.4) - 0.055).
    assert errors.mae == pytest.approx(255 * (1.055 * 0.4 ** (1 / 2.4) - 0.055), abs=1e-3)
    assert errors.rmse == pytest.approx(errors.mae)


@pytest.mark.slow
def test_the_command_writes_records_table_and_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_yale_b(tmp_path / "yale", 2)
    labels, out = tmp_path / "labels", tmp_path / "out"
    assert main(["photometric-stereo", str(tmp_path / "yale"), "--out", str(labels)]) == 0
    weights = tmp_path / "tiny.safetensors"
    torch.manual_seed(0)
    save_weights(weights, SfSNet(2, 2, 1), {"recipe": {"data": {"size": 32}}})
    capsys.readouterr()
    arguments = ["evaluate", "labels", str(labels), "--methods", "flat", "mean-face"]
    arguments += ["--weights", str(weights), "--out", str(out), "--json"]
    assert main(arguments) == 0
    records = {row["what"]: row["value"] for row in json.loads(capsys.readouterr().out)}
    for method in ("flat", "mean_face", "tiny"):
        for what in (
            "normals.mean_deg",
            "normals.below20",
            "albedo.scaled_rms",
            "lights64.top1",
            "images_per_s",
        ):
            assert f"yale_b.{method}.{what}" in records
    # Both subjects are the same ball: the mean of the other is right, and light then tells all classes apart.
    assert records["yale_b.mean_face.normals.mean_deg"] < 0.5 < 20 < records["yale_b.flat.normals.mean_deg"]
    assert records["yale_b.mean_face.lights64.top1"] == 100
    with (out / "table.csv").open() as file:
        rows = list(csv.reader(file))
    assert [row[0] for row in rows] == ["method", "flat", "mean-face", "tiny"]
    assert "data:image/png" in (out / "index.html").read_text()
    assert len(ANGLES) == 12
    assert main([*arguments[:-3], "--out", str(out), "--weights", str(weights), str(weights)]) == 2
    assert "would be called" in capsys.readouterr().err.strip().splitlines()[-1]


def test_lines_that_lie_on_each_other_are_drawn_once() -> None:
    lines: dict[str, list[float | None]] = {
        "flat": [3.0, None],
        "mean-face": [1.0, 2.0],
        "net": [1.0, 2.5],
        "mean-albedo": [1.0, 2.0],
    }
    assert merge_equal_methods(lines) == {
        "flat": [3.0, None],
        "mean-face, mean-albedo": [1.0, 2.0],
        "net": [1.0, 2.5],
    }
