"""Labels by photometric stereo: from a look-alike of a database to a folder that is read again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.look_alikes import ANGLES, crop_normals, write_photoface, write_yale_b, yale_name

from sfsnet_dr.cli.main import main
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.databases.registry import open_database
from sfsnet_dr.data.normal_labels import light_labels, load_normal_labels, read_index
from sfsnet_dr.experiments.photometric_stereo.captures import read_image_sets
from sfsnet_dr.experiments.photometric_stereo.run import compute_normal_labels
from sfsnet_dr.metrics.normals import angles_deg
from sfsnet_dr.sh.coefficients import Shading


def test_a_command_makes_labels_that_are_right(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_yale_b(tmp_path / "yale", 2)
    (tmp_path / "yale" / "yaleB01" / yale_name("yaleB01", 15, 0)).write_bytes(b"broken")
    out = tmp_path / "labels"
    assert main(["photometric-stereo", str(tmp_path / "yale"), "--out", str(out), "--json"]) == 0
    records = {row["what"]: row["value"] for row in json.loads(capsys.readouterr().out)}
    assert records["stereo.yale_b.captures"] == 2
    assert records["stereo.yale_b.skipped"] == 1
    assert records["stereo.yale_b.halves_deg"] < 1  # 8-bit steps
    faces = load_normal_labels(out)
    assert [face.subject for face in faces] == ["yaleB01", "yaleB02"]
    assert faces[0].images.shape == (len(ANGLES) - 1, 3, 128, 128)
    for face, albedo in zip(faces, (0.8, 0.7), strict=True):
        mask = face.mask[0].numpy() > 0.5
        normal = face.normal.permute(1, 2, 0).numpy()
        # 0.4 degrees measured: a pixel averages over a surface that bends, and 8-bit values are steps.
        assert angles_deg(normal, crop_normals())[mask].mean() < 0.8
        relative = face.albedo[0].numpy()[mask] / albedo
        assert relative.mean() == pytest.approx(1, abs=0.05)  # the lamps' mean strength is free within k
        model = (
            face.albedo
            * face.gain[:, None, None, None]
            * ((face.direction @ face.normal.reshape(3, -1)).clamp_min(0).reshape(-1, 1, 128, 128))
        )
        assert (model - face.image).abs()[:, :, mask].mean() < 0.01
    assert read_index(out)["captures"]["yaleB01_P00"]["subject"] == "yaleB01"
    assert (out / "sheet.png").is_file()


def test_four_lights_are_enough(tmp_path: Path) -> None:
    found = compute_normal_labels(read_image_sets(open_database("photoface", write_photoface(tmp_path))))
    assert len(found.labels) == 1
    assert np.isnan(found.halves[0])
    assert found.strobes.oblique == 0


def test_changed_or_missing_labels_are_refused(tmp_path: Path) -> None:
    compute_normal_labels(
        read_image_sets(open_database("photoface", write_photoface(tmp_path / "in"))), tmp_path / "out"
    )
    (face,) = load_normal_labels(tmp_path / "out")
    path = next((tmp_path / "out").glob("*.safetensors"))
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    with pytest.raises(InputError, match="changed since"):
        load_normal_labels(tmp_path / "out")
    with pytest.raises(InputError, match="no normal_labels"):
        load_normal_labels(tmp_path / "in")
    assert face.name == "1001/2008-02-23_11-23-00"


def test_a_folder_without_four_lights_is_refused_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_yale_b(tmp_path / "yale", 1)
    for azimuth, elevation in ANGLES[3:]:
        (tmp_path / "yale/yaleB01" / yale_name("yaleB01", azimuth, elevation)).unlink()
    assert main(["photometric-stereo", str(tmp_path / "yale"), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.strip()
    assert "3 usable lights, at least 4 are needed" in error.splitlines()[-1]
    assert not (tmp_path / "out").exists()


def test_light_labels_shade_as_the_light_does() -> None:
    direction = np.array([0.3, -0.2, 0.9]) / np.linalg.norm([0.3, -0.2, 0.9])
    (flat,) = light_labels(direction[None], [0.8])
    shading = Shading.from_flat(flat)
    # Order 2 gives 17/16 of the cosine facing the light, and 5/32 of negative 1 less at right angles.
    assert shading.evaluate(direction)[0] == pytest.approx(0.8 * 17 / 16)
    side = np.cross(direction, [0, 1.0, 0])
    assert shading.evaluate(side / np.linalg.norm(side))[0] == pytest.approx(0.8 * (1 / 4 - 5 / 32))
