"""The contact sheet shows every face of a folder, and one face is relit by what is asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfsnet_dr.cli.main import main
from sfsnet_dr.core.image_io import read_image, write_exr
from sfsnet_dr.data import generate
from sfsnet_dr.data.bundle import read_bundle, write_bundle
from sfsnet_dr.data.generate import synthesize
from sfsnet_dr.experiments.contact_sheet import lamp_from_text, tone_name, write_contact_sheet
from sfsnet_dr.scene.spec import CameraSpec, HeadSpec, SamplingSpec, SceneSpec

TINY = SceneSpec(
    "tiny",
    "anny",
    camera=CameraSpec(size=24),
    head=HeadSpec(subdivision=0, yaw=20.0),
    sampling=SamplingSpec(spp=32, reference_spp=16),
)
BUNDLE = "face-000000.exr"


@pytest.fixture(scope="module")
def faces(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One rendered face, and copies of it that say other skin tones."""
    folder = tmp_path_factory.mktemp("faces")
    synthesize(folder, TINY, 1)
    first = read_bundle(folder / BUNDLE)

    def tinted(spec: SceneSpec, seed: int) -> object:
        extra = first.meta.extra | {"ita": 60.0 - 30 * seed}
        return replace(first, meta=replace(first.meta, seed=seed, extra=extra))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(generate, "render_bundle", tinted)
        synthesize(folder, TINY, 5, resume=True)
    return folder


def test_the_sheet_shows_the_faces(faces: Path, tmp_path: Path) -> None:
    records = {
        record.what: record.value for record in write_contact_sheet(faces, tmp_path, 3, command="show")
    }
    first = read_bundle(faces / BUNDLE).meta.extra["ita"]
    assert records["synth.faces"] == 5
    assert records["skin.ita.min"] == min(first, -60)
    assert records["skin.ita.max"] == max(first, 30)
    sheet = read_image(tmp_path / "sheet.png").pixels
    cell, gap = 24 * 5, 8
    assert sheet.shape[1] == 12 * (cell + gap) - gap + 2 * 12
    text = (tmp_path / "index.html").read_text()
    assert [f"seed {seed}<" in text for seed in range(5)] == [True, False, True, False, True]
    assert "Skin tones" in text
    assert text.count("data:image/png;base64,") == 4 * 3 + 1
    assert "http" not in text.split("</style>")[1]


def test_without_tones_there_is_no_histogram(faces: Path, tmp_path: Path) -> None:
    folder = tmp_path / "toneless"
    first = read_bundle(faces / BUNDLE)
    plain = replace(first, meta=replace(first.meta, extra={}))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(generate, "render_bundle", lambda spec, seed: plain)
        synthesize(folder, TINY, 1)
    assert [record.what for record in write_contact_sheet(folder, tmp_path / "out")] == ["synth.faces"]
    assert "Skin tones" not in (tmp_path / "out" / "index.html").read_text()


def test_tones_have_names() -> None:
    names = {56: "very light", 55: "light", 30: "intermediate", 11: "tan", 0: "brown", -30: "dark"}
    assert {ita: tone_name(ita) for ita in names} == names


def test_an_even_map_lights_as_much_as_each_point_sees_of_it(faces: Path, tmp_path: Path) -> None:
    even = dict.fromkeys("RGB", np.full((16, 32), 7.0))
    write_exr(tmp_path / "even.exr", even, {})
    out = tmp_path / "relit.png"
    assert main(["relight", str(faces / BUNDLE), "--env", str(tmp_path / "even.exr"), "--out", str(out)]) == 0
    face = read_bundle(faces / BUNDLE)
    # Exposed so that white skin in the open shades to 0.8.
    expected = 0.8 * np.sqrt(4 * np.pi) * (face.transport[0] + face.gloss[0][..., None])
    picture = read_image(out).pixels
    shown = expected < 0.95
    # Half a step of 8-bit sRGB, at its steepest 2.3 / 510 in linear light, and 0.1 % of the map's projection.
    np.testing.assert_allclose(picture[shown], expected[shown], atol=0.006)


@pytest.mark.parametrize(("side", "sign"), [("-1,0,0.5", 1), ("1,0,0.5", -1)])
def test_a_lamp_lights_its_side(faces: Path, tmp_path: Path, side: str, sign: int) -> None:
    out = tmp_path / "relit.png"
    assert main(["relight", str(faces / BUNDLE), f"--direction={side}", "--out", str(out)]) == 0
    mean = read_image(out).pixels.mean(axis=(0, 2))
    assert sign * (mean[:12].sum() - mean[12:].sum()) > 0.1 * mean.sum()


def test_a_lamp_has_a_unit_direction() -> None:
    [(toward, _)] = lamp_from_text("0,3,4").directional
    np.testing.assert_allclose(toward, [0, 0.6, 0.8])


def relit(faces: Path, folder: Path, *more: str, name: str = "relit.png") -> list[str]:
    return ["relight", str(faces / BUNDLE), "--out", str(folder / name), *more]


def poisoned(faces: Path, folder: Path) -> list[str]:
    (folder / "map.exr").touch()
    return relit(faces, folder, "--env", str(folder / "map.exr"))


def no_bundle(faces: Path, folder: Path) -> list[str]:
    write_exr(folder / "map.exr", dict.fromkeys("RGB", np.ones((16, 32))), {})
    return ["relight", str(folder / "map.exr"), "--direction=0,0,1", "--out", str(folder / "relit.png")]


def half_a_bundle(faces: Path, folder: Path) -> list[str]:
    target = folder / "data"
    target.mkdir()
    write_bundle(target / BUNDLE, read_bundle(faces / BUNDLE))
    (target / BUNDLE).write_bytes((faces / BUNDLE).read_bytes()[:5000])
    (target / "manifest.jsonl").write_bytes((faces / "manifest.jsonl").read_bytes())
    return ["contact-sheet", str(target), "--out", str(folder / "out")]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (lambda faces, folder: relit(faces, folder), "neither of --env and --direction"),
        (lambda faces, folder: relit(faces, folder, "--direction=1,2"), "three finite numbers"),
        (lambda faces, folder: relit(faces, folder, "--direction=0,0,0"), "not all 0"),
        (lambda faces, folder: relit(faces, folder, "--direction=a,b,c"), "'a,b,c' found"),
        (lambda faces, folder: relit(faces, folder, "--direction=0,0,-1"), "no light falls"),
        (lambda faces, folder: relit(faces, folder, "--direction=0,0,1", "--exposure=-1"), "--exposure: -1"),
        (
            lambda faces, folder: relit(faces, folder, "--direction=0,0,1", "--photo-seed=-1"),
            "--photo-seed: -1",
        ),
        (
            lambda faces, folder: relit(faces, folder, "--direction=0,0,1", name="relit.jpg"),
            "written as .png",
        ),
        (lambda faces, folder: relit(faces, folder, "--env", str(folder / "absent.exr")), "absent.exr"),
        (poisoned, "0 bytes"),
        (no_bundle, "a bundle of `sfsnet-dr synth` expected"),
        (half_a_bundle, "face-000000.exr"),
        (
            lambda faces, folder: ["contact-sheet", str(folder), "--out", str(folder / "out")],
            "no bundles listed",
        ),
        (
            lambda faces, folder: ["contact-sheet", str(faces), "--out", str(folder / "out"), "--count=0"],
            "count: 0",
        ),
    ],
)
def test_bad_input_is_one_line(
    faces: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    arguments: Callable[[Path, Path], list[str]],
    words: str,
) -> None:
    assert main(arguments(faces, tmp_path)) == 2
    told = capfd.readouterr().err
    assert told.count("\n") == 1
    assert words in told
    assert not list(tmp_path.glob("relit*"))
    assert not (tmp_path / "out").exists()
