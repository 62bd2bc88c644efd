"""Evaluation on each kind of data: what it counts, what it leaves out, and how it refuses."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from experiments.evaluation.test_measure import FAR, FRONT, SIDE, collected, face, tilted
from helpers.look_alikes import face_points, write_celeba, write_multipie, write_yale_b, yale_name
from helpers.spheres import write_spheres
from PIL import Image
from torch import Tensor

from sfsnet_dr.cli.main import main
from sfsnet_dr.core.errors import InputError, RunError
from sfsnet_dr.data.databases.registry import open_database, recognise_database
from sfsnet_dr.experiments.evaluation import synthetic as module
from sfsnet_dr.experiments.evaluation.collect import Amount, collect_samples
from sfsnet_dr.experiments.evaluation.failure_cases import describe_failure, example_rows, find_extremes
from sfsnet_dr.experiments.evaluation.gallery import samples_for_transfer
from sfsnet_dr.experiments.evaluation.labelled import light_causes
from sfsnet_dr.experiments.evaluation.measure import REGIONS, face_regions, measure_methods
from sfsnet_dr.experiments.evaluation.records import evaluation_records, sample_counts
from sfsnet_dr.experiments.evaluation.run import find_data
from sfsnet_dr.experiments.evaluation.unlabelled import photograph_samples
from sfsnet_dr.inference.methods import FlatNormals, Prediction
from sfsnet_dr.models.sfsnet import SfSNet
from sfsnet_dr.models.weights import save_weights
from sfsnet_dr.scene.lights.spec import LightSpec


def write_photographs(folder: Path, count: int = 5) -> Path:
    """Grey-blue pictures with landmarks of a face."""
    folder.mkdir(parents=True)
    names = [f"{number}.png" for number in range(count)]
    for number, name in enumerate(names):
        colour = (90, 90 + 5 * number, 160)
        Image.fromarray(np.full((110, 102, 3), colour, np.uint8)).save(folder / name)
    np.savez(folder / "landmarks.npz", files=np.array(names), points=np.array([face_points()] * count))
    return folder


class Half:
    """Answers with half of the photograph in linear light, as a reconstruction of its own."""

    name = "half"

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Prediction:
        normal = torch.zeros_like(images)
        normal[:, 2] = 1
        light = torch.zeros(len(images), 27)
        light[:, 0] = 1
        return Prediction(normal, images, light, images / 2)


def test_reconstruction_that_is_the_image_by_construction_is_not_told() -> None:
    collection = collected(face("a", 0, [FRONT]), face("b", 0, [FRONT]))
    records = {
        r.what for r in evaluation_records(collection, measure_methods(FlatNormals(), collection.shots), "")
    }
    assert "yale_b.flat.albedo.scaled_rms" in records
    assert not any(".recon." in what for what in records)
    records = {r.what for r in evaluation_records(collection, measure_methods(Half(), collection.shots), "")}
    # Grey photographs have no Delta E.
    assert {what for what in records if ".recon." in what} == {
        "yale_b.half.recon.mae",
        "yale_b.half.recon.rmse",
    }


def test_colour_photographs_are_reconstructed_with_known_errors(tmp_path: Path) -> None:
    folder = write_photographs(tmp_path / "photos")
    Image.fromarray(np.zeros((110, 102, 3), np.uint8)).save(folder / "unmarked.png")
    collection = collect_samples("folder", [folder], Amount())
    assert [len(collection.shots), len(collection.skipped)] == [5, 1]
    found = measure_methods(Half(), collection.shots)
    records = {
        r.what: r.value for r in [*sample_counts(collection, ""), *evaluation_records(collection, found, "")]
    }
    assert [records[f"folder.{name}"] for name in ("images", "subjects", "skipped")] == [5, 5, 1]
    decoded = [((v / 255 + 0.055) / 1.055) ** 2.4 for v in (90, 100, 160)]
    encoded = [255 * (1.055 * (v / 2) ** (1 / 2.4) - 0.055) for v in decoded]
    differences = np.array([90, 100, 160]) - encoded
    assert records["folder.half.recon.mae"] == pytest.approx(differences.mean(), abs=0.05)
    assert records["folder.half.recon.rmse"] == pytest.approx(np.sqrt((differences**2).mean()), abs=0.05)
    assert 5 < records["folder.half.recon.delta_e"] < 30
    assert not any("normals" in what or "direction" in what for what in records)


def test_photographs_are_those_that_training_holds_back(tmp_path: Path) -> None:
    from sfsnet_dr.data.photos import list_photos, split_holdout

    folder = write_photographs(tmp_path / "photos", 9)
    held = {photo.name for photo in split_holdout(list_photos(folder)[0], 4)[1]}
    shots = photograph_samples(open_database("folder", folder), 4).shots
    assert {shot.name for shot in shots} == held


def test_of_celeba_the_test_part_is_measured(tmp_path: Path) -> None:
    collection = collect_samples("celeba", [write_celeba(tmp_path, 7)], Amount())
    assert {shot.name for shot in collection.shots} == {"000003.jpg", "000006.jpg"}
    assert collection.data == "celeba"


def test_lights_alone_need_no_surface(tmp_path: Path) -> None:
    folder = write_yale_b(tmp_path / "yale", 2)
    (folder / "yaleB02" / "strange.pgm").write_bytes(b"P5")
    (folder / "yaleB02" / yale_name("yaleB02", 15, 0)).write_bytes(b"P5\n168 192\n255\n")
    collection = collect_samples("lights", [folder], Amount())
    found = measure_methods(FlatNormals(), collection.shots)
    records = {r.what: r.value for r in evaluation_records(collection, found, "")}
    assert records["yale_b.flat.lights64.classes"] == 11  # one light is left with a single subject
    assert "yale_b.flat.lights.top1" not in records  # the 19 are not all there
    assert "yale_b.flat.lights.direction_deg" in records
    assert not any("normals" in what for what in records)
    assert len(collection.skipped) == 2
    with pytest.raises(InputError, match="no lights known"):
        collect_samples("lights", [write_photographs(tmp_path / "photos")], Amount(database="folder"))


def test_multipie_has_nineteen_lights_of_its_own(tmp_path: Path) -> None:
    collection = collect_samples("lights", [write_multipie(tmp_path)], Amount(database="multipie"))
    assert {shot.light for shot in collection.shots} == {"00", "07"}
    assert len(collection.few) == 19


def test_rendered_faces_come_with_all_truth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lobes = LightSpec(hdr=0, sun_sky=0, studio=0, directional=0, ambient=0, lobes=1)
    monkeypatch.setattr(module, "OPTIONS", replace(module.OPTIONS, light=lobes))
    write_spheres(tmp_path, 5)
    collection = collect_samples("synthetic", [tmp_path], Amount(most=4))
    assert len(collection.shots) == 4
    assert len(collection.subjects) == 2  # two of five are held back
    found = measure_methods(FlatNormals(), collection.shots)
    records = {r.what for r in evaluation_records(collection, found, "")}
    for what in ("normals.mean_deg", "albedo.scaled_rms", "lights.scaled_rms", "lights.direction_deg"):
        assert f"synthetic.flat.{what}" in records


def test_regions_divide_the_mask() -> None:
    mask = np.ones((128, 128))
    mask[40:50, 40:50] = 0  # an eye is no outline
    regions = face_regions(mask)
    assert list(regions) == list(REGIONS)
    np.testing.assert_array_equal(sum(part.astype(int) for part in regions.values()), mask)
    assert [name for name in REGIONS if regions[name][70, 64]] == ["nose"]
    assert [name for name in REGIONS if regions[name][48, 90]] == ["eyes"]
    assert [name for name in REGIONS if regions[name][20, 64]] == ["forehead"]
    assert [name for name in REGIONS if regions[name][95, 64]] == ["mouth and chin"]
    assert [name for name in REGIONS if regions[name][70, 30]] == ["cheeks"]
    assert [name for name in REGIONS if regions[name][70, 2]] == ["outline"]
    assert not regions["outline"][45, 52]


def test_causes_of_a_known_picture() -> None:
    labels = face("a", 0, [FRONT, SIDE])
    # Albedo 0.5 under a frontal light of strength 1 is 0.5; the first half gets less than half of it.
    labels.image[0, :, :2] = 0.2
    labels.image[0, :, 2:] = 0.5
    labels.image[0, :, 3] = 0.99
    found = light_causes(labels, 0)
    assert found["cast shadow"] == 50
    assert found["gloss"] == 25
    assert found["turned away"] == 0
    assert light_causes(labels, 1)["light (deg)"] == pytest.approx(30, abs=0.01)


def test_worst_photographs_are_explained_by_what_grows_with_the_error() -> None:
    class Wrong:
        """Off by the light's angle."""

        name = "wrong"

        def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Prediction:
            normal = torch.stack([tilted(float(image.mean()) * 100) for image in images])
            return Prediction(normal, images, torch.ones(len(images), 27), images)

    labels = face("a", 0, [FRONT, SIDE, FAR])
    labels.image[:] = torch.tensor([0.1, 0.2, 0.3])[:, None, None, None]
    measured = measure_methods(Wrong(), collected(labels).shots)
    found = find_extremes(measured.images)
    assert found is not None
    assert [e.normals.mean for e in found.best + found.worst if e.normals] == pytest.approx(
        [10, 30], abs=0.01
    )
    (light,) = (cause for cause in found.causes if cause.name == "light (deg)")
    assert light.rank == pytest.approx(1)
    assert light.worst == pytest.approx(78.5, abs=0.1)
    assert describe_failure(found.worst[0].shot, found.causes) == "light 79 deg"
    assert len(example_rows(measured.images, 2)) == 2
    assert samples_for_transfer(measured.images) == []  # one person cannot exchange anything


def test_two_people_exchange_their_lights() -> None:
    ways = [[-0.6, 0, 0.8], FRONT, [0.6, 0, 0.8], [0, 0.6, 0.8]]
    collection = collected(face("a", 0, ways), face("b", 10, ways))
    pairs = samples_for_transfer(measure_methods(Half(), collection.shots).images)
    assert len(pairs) == 3
    assert [(p.first.light, p.second.light) for p in pairs] == [("l0", "l2"), ("l2", "l1"), ("l3", "l0")]
    for pair in pairs:
        assert pair.first.subject != pair.second.subject
        assert pair.first_so is not None
        assert (pair.first_so.subject, pair.first_so.light) == (pair.first.subject, pair.second.light)


def test_an_answer_that_is_not_finite_is_an_error() -> None:
    class Broken(Half):
        def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Prediction:
            return super().__call__(images, masks, subjects)._replace(albedo=images * float("nan"))

    with pytest.raises(RunError, match="half: its answer for 0 is not finite"):
        measure_methods(Broken(), collected(face("a", 0, [FRONT])).shots)


def test_folders_are_recognised(tmp_path: Path) -> None:
    write_yale_b(tmp_path / "a", 1)
    write_celeba(tmp_path / "b")
    write_multipie(tmp_path / "c")
    write_photographs(tmp_path / "d" / "part")
    write_photographs(tmp_path / "e")
    (tmp_path / "f").mkdir()
    kinds = [recognise_database(tmp_path / name) for name in "abcdef"]
    assert kinds == ["yale-b", "celeba", "multipie", "folder", "folder", None]
    with pytest.raises(InputError, match="d and e both look like folder"):
        find_data(tmp_path)
    with pytest.raises(InputError, match="none of yale-b"):
        find_data(tmp_path / "f")
    assert find_data(tmp_path / "e", [tmp_path]) == [("folder", [tmp_path / "e"]), ("synthetic", [tmp_path])]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["yale-b", "{}/photos"], "holds no photographs of yale-b; it looks like folder"),
        (["celeba", "{}/photos"], "it looks like folder"),
        (["synthetic", "{}/photos"], "no bundles listed"),
        (["{}/none"], "neither a folder nor a kind of data"),
        (["yaleb", "{}/photos"], "did you mean 'yale-b'?"),
        (["folder"], "0 folders found, one is needed"),
        (["all", "{}/none"], "no such folder"),
        (["folder", "{}/photos", "--max-images", "0"], "at least 1 is needed"),
        (["folder", "{}/photos", "--faces", "x"], "--faces"),
    ],
)
def test_bad_input_ends_with_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    write_photographs(tmp_path / "photos", 2)
    out = tmp_path / "out"
    given = [argument.format(tmp_path) for argument in arguments]
    assert main(["evaluate", *given, "--out", str(out)]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len([line for line in lines if line.startswith("sfsnet-dr: ")]) == 1
    assert words in lines[-1]
    assert not out.exists()


@pytest.mark.slow
def test_all_data_end_on_one_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_photographs(tmp_path / "data" / "photos", 4)
    yale = write_yale_b(tmp_path / "data" / "yale", 2)
    few = yale / "yaleB03"
    few.mkdir()
    (few / yale_name("yaleB03", 0, 0)).write_bytes(
        (yale / "yaleB01" / yale_name("yaleB01", -15, 0)).read_bytes()
    )
    write_spheres(tmp_path / "faces", 3)
    weights, out = tmp_path / "tiny.safetensors", tmp_path / "out"
    save_weights(weights, SfSNet(2, 2, 1), {"recipe": {"data": {"size": 16}}})
    arguments = ["evaluate", "all", str(tmp_path / "data"), "--faces", str(tmp_path / "faces"), "--json"]
    assert main([*arguments, "--weights", str(weights), "--max-images", "4", "--out", str(out)]) == 0
    records = {row["what"]: row["value"] for row in json.loads(capsys.readouterr().out)}
    assert records["yale_b.skipped"] == 1
    assert records["yale_b.images"] == 24
    assert {what.split(".")[0] for what in records} == {"yale_b", "folder", "synthetic"}
    assert len(json.loads((out / "records.json").read_text())) == len(records)
    page = (out / "yale-b" / "index.html").read_text()
    assert "24 photographs of 2 subjects" in page
    assert "at least 4 are needed" in page
    assert 'href="yale-b/index.html"' in (out / "index.html").read_text()
