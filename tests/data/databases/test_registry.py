"""Readers of face databases on tiny look-alikes: what is found, what is refused, and why."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.look_alikes import ANGLES, write_celeba, write_multipie, write_photoface, write_yale_b, yale_name
from PIL import Image

from sfsnet_dr.cli.main import main
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.databases.base import read_face
from sfsnet_dr.data.databases.registry import check_database, open_database
from sfsnet_dr.data.databases.yale_b import LIGHTS_19


@pytest.mark.parametrize("suffix", [".pgm", ".png"])
def test_yale_b(tmp_path: Path, suffix: str) -> None:
    found = open_database("yale-b", write_yale_b(tmp_path, 2, suffix))
    assert found.subjects == ("yaleB01", "yaleB02")
    assert len(found.photos) == 2 * len(ANGLES)
    assert found.linear
    assert list(found.captures()) == ["yaleB01_P00", "yaleB02_P00"]
    photo = next(p for p in found.photos if p.light == "A+050E+25")
    # A positive azimuth lights the image's left side: x of the direction is negative.
    expected = (
        -np.sin(np.radians(50)) * np.cos(np.radians(25)), np.sin(np.radians(25)),
        np.cos(np.radians(50)) * np.cos(np.radians(25)),
    )  # fmt: skip
    assert photo.direction == pytest.approx(expected)
    face = read_face(photo, found.linear)
    assert face.grey
    assert face.image.shape == (128, 128, 3)
    assert face.image[64, 40:50].mean() > 2 * face.image[64, 84:94].mean()
    assert face.mask[64, 64] == 1
    assert face.mask[48, 45] == 0  # the eye
    assert face.mask[5, 64] == 0  # beyond the crop


def test_yale_b_reads_values_as_linear_light(tmp_path: Path) -> None:
    found = open_database("yale-b", write_yale_b(tmp_path, 1))
    photo = next(p for p in found.photos if p.light == "A+015E+00")
    raw = np.asarray(Image.open(photo.path), np.float64) / 255
    face = read_face(photo, found.linear)
    assert face.image[66, 64, 0] == pytest.approx(raw[90:97, 80:87].mean(), abs=0.01)


def test_yale_b_names_what_it_skips(tmp_path: Path) -> None:
    part = write_yale_b(tmp_path, 1) / "yaleB01"
    (part / "yaleB01_P00_Ambient.pgm").write_bytes(b"")
    (part / "yaleB01_P00.info").write_text("x")
    (part / (yale_name("yaleB01", 70, 0) + ".bad")).write_bytes(b"")
    (part / "holiday.pgm").write_bytes(b"")
    (part / yale_name("yaleB01", 20, 10)).write_bytes(b"no picture")
    (part / yale_name("yaleB02", 20, 10)).write_bytes((part / yale_name("yaleB01", 15, 0)).read_bytes())
    Image.fromarray(np.zeros((192, 168), np.uint16)).save(part / yale_name("yaleB01", 5, 10, ".png"))
    Image.fromarray(np.zeros((480, 640), np.uint8)).save(part / yale_name("yaleB01", -5, 10))
    reasons = {item.name.split("/")[1]: item.reason for item in open_database("yale-b", tmp_path).skipped}
    assert len(reasons) == 6
    assert "marked as bad" in reasons[yale_name("yaleB01", 70, 0) + ".bad"]
    assert "does not parse" in reasons["holiday.pgm"]
    assert "broken" in reasons[yale_name("yaleB01", 20, 10)]
    assert "picture of yaleB02" in reasons[yale_name("yaleB02", 20, 10)]
    assert "16 bits" in reasons[yale_name("yaleB01", 5, 10, ".png")]
    assert "640 x 480" in reasons[yale_name("yaleB01", -5, 10)]


def test_the_nineteen_lights_are_nineteen_of_the_rig() -> None:
    from sfsnet_dr.experiments.photometric_stereo.check import light_rig

    assert len(set(LIGHTS_19)) == 19
    lights = light_rig()
    assert len({tuple(np.round(light, 6)) for light in lights}) == 64
    for name in LIGHTS_19:
        azimuth, elevation = np.radians(float(name[1:5])), np.radians(float(name[6:]))
        direction = [
            -np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
            np.cos(azimuth) * np.cos(elevation),
        ]
        assert (lights @ direction).max() == pytest.approx(1)


def test_celeba(tmp_path: Path) -> None:
    found = open_database("celeba", write_celeba(tmp_path))
    assert [p.part for p in found.photos] == ["train", "val", "test", "train"]
    assert found.subjects == ("7", "8")
    assert found.photos[0].eyes == ((69, 111), (108, 112))
    assert not found.linear
    assert read_face(found.photos[0], False).mask.max() == 1
    (tmp_path / "Anno/identity_CelebA.txt").write_text("000001.jpg 7\n")
    assert [s.name for s in open_database("celeba", tmp_path).skipped] == [f"00000{k}.jpg" for k in (2, 3, 4)]
    (tmp_path / "Anno/identity_CelebA.txt").write_text("000001.jpg\n")
    with pytest.raises(InputError, match=r"identity_CelebA.txt:1: 1 columns found, 2 expected"):
        open_database("celeba", tmp_path)


def test_photoface(tmp_path: Path) -> None:
    found = open_database("photoface", write_photoface(tmp_path, 2))
    assert len(found.photos) == 8
    assert found.subjects == ("1001",)
    assert found.photos[0].eyes == ((33, 40), (67, 40))
    z, a = np.radians(40), np.radians(45)
    assert found.photos[0].direction == pytest.approx(
        (np.sin(z) * np.cos(a), np.sin(z) * np.sin(a), np.cos(z))
    )
    first = tmp_path / "1001" / "2008-02-23_11-23-00"
    (first / "im2.bmp").unlink()
    assert "im2.bmp is missing" in open_database("photoface", tmp_path).skipped[0].reason
    (tmp_path / "1001" / "2008-02-23_11-23-01" / "LightSource.m").write_text("zenith = [1 2 3];")
    with pytest.raises(InputError, match="no photograph of photoface"):
        open_database("photoface", tmp_path)


def test_multipie_takes_the_frontal_camera_and_nineteen_lights(tmp_path: Path) -> None:
    found = open_database("multipie", write_multipie(tmp_path))
    assert sorted({p.light for p in found.photos}) == ["00", "07"]
    assert found.subjects == ("001", "002")
    assert len(found.photos) == 4
    assert found.photos[0].points is not None
    (tmp_path / "landmarks.npz").unlink()
    with pytest.raises(InputError, match="landmarks"):
        open_database("multipie", tmp_path)


def test_plain_folder(tmp_path: Path) -> None:
    Image.fromarray(np.full((128, 128, 3), 90, np.uint8)).save(tmp_path / "canonical.png")
    Image.fromarray(np.full((200, 180, 3), 90, np.uint8)).save(tmp_path / "with_eyes.jpg")
    (tmp_path / "with_eyes.toml").write_text("eye_image_left = [60, 80]\neye_image_right = [120, 80]\n")
    Image.fromarray(np.full((200, 180, 3), 90, np.uint8)).save(tmp_path / "without.jpg")
    found = open_database("folder", tmp_path)
    assert [p.name for p in found.photos] == ["canonical.png", "with_eyes.jpg"]
    assert "180 x 200 pixels and no eye centres" in found.skipped[0].reason
    image = read_face(found.photos[0], False).image
    assert (image == image[0, 0]).all()  # not resampled


@pytest.mark.parametrize("name", ["yale-b", "photoface", "celeba", "multipie", "folder"])
def test_a_folder_of_something_else_is_refused_in_one_line(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "notes.txt").write_text("nothing")
    assert main(["data", "check", name, str(tmp_path)]) == 2
    assert main(["data", "check", name, str(tmp_path / "absent")]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 2


def test_check_counts_broken_files_and_captures_with_few_lights(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_yale_b(tmp_path, 2)
    for azimuth, elevation in ANGLES[:-3]:
        (tmp_path / "yaleB02" / yale_name("yaleB02", azimuth, elevation)).unlink()
    cut = tmp_path / "yaleB01" / yale_name("yaleB01", 15, 0)
    cut.write_bytes(cut.read_bytes()[:500])
    found = check_database("yale-b", tmp_path)
    assert found.few_lights == ("yaleB02_P00",)
    assert found.counts["skipped"] == 1
    assert found.counts["decoded"] == len(ANGLES) + 3 - 1
    assert main(["data", "check", "yale-b", str(tmp_path), "--json"]) == 0
    records = {row["what"]: row["value"] for row in json.loads(capsys.readouterr().out)}
    assert records["data.yale_b.captures_with_few_lights"] == 1
