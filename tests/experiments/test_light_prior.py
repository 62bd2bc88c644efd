"""From a folder of photographs to a light prior: what is used, what is told, what a stopped run keeps."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from estimation.test_morphable_fit import marks, random_faces
from helpers.fake_face import fake_model

from sfsnet_dr.cli.main import main
from sfsnet_dr.core.errors import InputError, RunError
from sfsnet_dr.core.image_io import write_png
from sfsnet_dr.estimation import light_prior as module
from sfsnet_dr.estimation.light_prior import PhotographFit, fit_photographs, learn_mixture, normalise_exposure
from sfsnet_dr.estimation.morphable_fit import Placement, face_maps, fit_face
from sfsnet_dr.estimation.sh_lighting import MEAN_SKIN
from sfsnet_dr.experiments.light_prior import FitLightsOptions, fit_lights
from sfsnet_dr.scene.faces.linear_model import FaceModes
from sfsnet_dr.scene.lights.photo_prior import read_mixture
from sfsnet_dr.scene.lights.vmf_lobes import sample_lights
from sfsnet_dr.sh.coefficients import Shading

Array = npt.NDArray[np.float64]

#: Photographs, and the parts of ``Placement`` that are given to each.
COUNT = 6
PARTS = ("rotation", "shift", "scale", "weights", "error")


@pytest.fixture(scope="module")
def model() -> FaceModes:
    return fake_model()


def pictures(model: FaceModes) -> tuple[Array, Placement, list[Shading]]:
    """Six faces of the model, each under a light of its own, on mean skin."""
    every = random_faces(model, turn=6.0)
    faces = Placement(*(getattr(every, name)[:COUNT] for name in PARTS))
    lights = [
        light.coefficients(2).to_shading() for light in sample_lights(np.random.default_rng(7), len(faces))
    ]
    images = [
        np.clip(MEAN_SKIN * light.evaluate(face_maps(model, faces, k).normal), 0.0, 0.9)
        for k, light in enumerate(lights)
    ]
    return np.array(images), faces, lights


def write_folder(folder: Path, model: FaceModes) -> Path:
    """The faces as photographs with landmarks beside their folder."""
    folder.mkdir()
    images, faces, _ = pictures(model)
    names = [f"{number:03d}.png" for number in range(len(images))]
    for name, image in zip(names, images, strict=True):
        write_png(folder / name, image)
    np.savez(
        folder.with_name(f"{folder.name}_landmarks.npz"), files=np.array(names), points=marks(model, faces)
    )
    return folder


def test_a_rendered_face_gives_its_normals_and_its_light_back(model: FaceModes) -> None:
    images, faces, lights = pictures(model)
    points = marks(model, faces)
    angles, errors = [], []
    for k, truth in enumerate(lights):
        found = fit_face(images[k], points[k], model)
        exact = face_maps(model, faces, k).normal
        both = (found.mask > 0.5) & (np.abs(exact).sum(-1) > 0)
        assert both.sum() > 2000
        cosine = (exact * found.normal).sum(-1)[both]
        angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())
        shades = [light.evaluate(exact[both]) for light in (found.light, truth)]
        errors.append(np.linalg.norm(shades[0] - shades[1]) / np.linalg.norm(shades[1]))
    assert np.mean(angles) < 4.0  # shrunk identities: 2.4 seen
    assert np.mean(errors) < 0.05
    assert max(errors) < 0.12


def test_fits_of_a_folder_go_on_where_they_were_stopped(
    model: FaceModes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_BATCH", 2)
    photos = write_folder(tmp_path / "p", model)
    (photos / "003.png").write_bytes(b"no picture")
    with np.load(tmp_path / "p_landmarks.npz") as file:
        files, points = file["files"], file["points"]
    points[1] = np.nan
    np.savez(tmp_path / "p_landmarks.npz", files=files[:5], points=points[:5])
    done: list[int] = []
    whole = fit_photographs(photos, model, tmp_path / "whole", on_photo=lambda: done.append(1))
    assert len(done) == 4
    assert [fit.name for fit in whole.fits] == ["000.png", "002.png", "004.png"]
    assert set(whole.skipped) == {"001.png", "003.png", "005.png"}

    def stop() -> None:
        if len(done) == 7:
            raise KeyboardInterrupt
        done.append(1)

    with pytest.raises(KeyboardInterrupt):
        fit_photographs(photos, model, tmp_path / "cut", on_photo=stop)
    path = tmp_path / "cut" / "fits.jsonl"
    assert len(path.read_text().splitlines()) == 3
    path.write_text(path.read_text() + '{"name": "torn')
    again = fit_photographs(photos, model, tmp_path / "cut")
    assert again.skipped == whole.skipped
    for a, b in zip(again.fits, whole.fits, strict=True):
        assert a.name == b.name
        np.testing.assert_allclose(a.light, b.light, rtol=1e-6)
    foreign = path.read_text().replace('"fake"', '"other"')
    path.write_text(foreign)
    with pytest.raises(InputError, match="choose another folder"):
        fit_photographs(photos, model, tmp_path / "cut")
    path.write_text("no json\n")
    with pytest.raises(InputError, match=r"fits\.jsonl: a line is no JSON"):
        fit_photographs(photos, model, tmp_path / "cut")


def many_fits(count: int = 300) -> list[PhotographFit]:
    lights = sample_lights(np.random.default_rng(1), count)
    flat = [light.coefficients(2).to_shading().flat() for light in lights]
    return [PhotographFit(f"{k}.png", light, 0.1, 1.0, False, 0.1) for k, light in enumerate(flat)]


def test_a_mixture_leaves_out_what_tells_nothing() -> None:
    fits = many_fits()
    spoilt = [
        PhotographFit("grey", fits[0].light, 0.1, 1.0, True, 0.1),
        PhotographFit("odd", fits[0].light, 0.9, 1.0, False, 0.1),
    ]
    learnt = learn_mixture([*fits, *spoilt], (1, 2), 0, {"skipped": 3})
    assert learnt.source["photographs"] == 300
    assert learnt.source["left_out_grey"] == learnt.source["left_out_residual"] == 1
    assert learnt.source["skipped"] == 3
    np.testing.assert_array_equal(learnt.means, learn_mixture(fits, (1, 2), 0, {}).means)
    with pytest.raises(InputError, match="20 finite rows found"):
        learn_mixture(fits[:20], (1,), 0, {})


def test_lights_are_brought_to_one_level_and_a_white_median() -> None:
    lights = np.array([fit.light for fit in many_fits(50)])
    tinted = normalise_exposure(lights * np.repeat([2.0, 1.0, 0.4], 9))
    np.testing.assert_allclose(tinted, normalise_exposure(lights), atol=1e-9)


def test_the_whole_study_writes_numbers_and_no_more(
    model: FaceModes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photos = write_folder(tmp_path / "p", model)
    wanted = many_fits()
    monkeypatch.setattr(
        "sfsnet_dr.experiments.light_prior.learn_mixture", lambda *a: learn_mixture(wanted, (1,), 0, {})
    )
    told = fit_lights(photos, model, tmp_path / "out", FitLightsOptions(most=3, draws=500))
    assert told.numbers["photographs"][0] == 3
    assert 0 <= told.numbers["mixture.rejected"][0] < 1
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "fits.jsonl",
        "mixture.json",
        "overlays.png",
    ]
    source = read_mixture(tmp_path / "out" / "mixture.json").source
    assert source["rejected_share"] == pytest.approx(told.numbers["mixture.rejected"][0], abs=1e-4)
    rows = [json.loads(line) for line in (tmp_path / "out" / "fits.jsonl").read_text().splitlines()[1:]]
    assert all(len(row["light"]) == 27 for row in rows)


def test_photographs_of_nothing_fail_with_one_line(model: FaceModes, tmp_path: Path) -> None:
    photos = write_folder(tmp_path / "p", model)
    for path in photos.iterdir():
        path.write_bytes(b"no picture")
    with pytest.raises(RunError, match="none of 6 photographs could be fitted"):
        fit_photographs(photos, model, tmp_path / "out")


@pytest.mark.parametrize(
    ("files", "message"),
    [(["a.txt"], "no photographs found"), (["a.png"], "no landmarks found"), ([], "no such folder")],
)
def test_bad_folders_end_the_command(
    files: list[str], message: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    if files:
        (tmp_path / "p").mkdir()
    for name in files:
        (tmp_path / "p" / name).touch()
    arguments = [
        str(tmp_path / "p"),
        "--model-path",
        str(tmp_path / "absent.npz"),
        "--out",
        str(tmp_path / "o"),
    ]
    assert main(["fit-light-prior", *arguments]) == 2
    told = capfd.readouterr()
    assert len(told.err.splitlines()) == 1
    assert message in told.err
    assert not (tmp_path / "o").exists()
