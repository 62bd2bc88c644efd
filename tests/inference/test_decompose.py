"""Decomposition of pictures: what is written, what the parts mean, and that it is all or nothing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from sfsnet_dr.core.color import linear_to_srgb
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.image_io import read_exr, read_image, write_png
from sfsnet_dr.data.alignment import face_ellipse_mask
from sfsnet_dr.inference import outputs
from sfsnet_dr.inference.decompose import decompose_files, reconstruction_error
from sfsnet_dr.inference.photograph import parse_eyes, read_photograph
from sfsnet_dr.models.inference import predict_with_flip_tta
from sfsnet_dr.models.sfsnet import SfSNet
from sfsnet_dr.models.skipnet import SkipNet
from sfsnet_dr.models.weights import save_weights
from sfsnet_dr.render.shading_numpy import f_render

EYES = ((58.0, 66.0), (102.0, 66.0))
FILES = {
    "input.png", "normal.png", "albedo.png", "shading.png", "reconstruction.png", "relit_left.png",
    "relit_right.png", "relit_top.png", "sheet.png", "decomposition.exr",
}  # fmt: skip


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    model = SfSNet(4, 4, 1)
    *_, bias = model.normal_head.parameters()
    torch.nn.init.constant_(bias, 0.5)  # so small a network would have pixels without any normal
    save_weights(path, model)
    return path


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    ramp = np.linspace(0.05, 0.9, 128)
    write_png(
        tmp_path / "face.png",
        np.stack([np.outer(ramp, ramp), np.outer(ramp, 1 - ramp), np.outer(1 - ramp, ramp)], -1),
    )
    return tmp_path / "face.png"


def test_one_folder_a_picture_with_every_file(tmp_path: Path, picture: Path, weights: Path) -> None:
    [face] = decompose_files([picture], tmp_path / "out", weights)
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["face"]
    assert {p.name for p in (tmp_path / "out/face").iterdir()} == FILES
    assert face.name == "face"
    for name in FILES - {"sheet.png", "decomposition.exr"}:
        assert read_image(tmp_path / "out/face" / name).pixels.shape == (128, 128, 3), name


def test_the_parts_make_the_reconstruction(tmp_path: Path, picture: Path, weights: Path) -> None:
    [face] = decompose_files([picture], tmp_path / "out", weights)
    planes = [np.moveaxis(part, -1, 0)[None] for part in (face.normal, face.albedo)]
    expected = np.moveaxis(f_render(planes[0], planes[1], face.light.flat()[None])[0], 0, -1)
    np.testing.assert_allclose(face.reconstruction, expected, atol=1e-12)
    # The network normalises in float32: 1e-7 a component.
    np.testing.assert_allclose(np.linalg.norm(face.normal, axis=-1), 1, atol=1e-6)
    np.testing.assert_allclose(face.image, read_image(picture).pixels)
    assert reconstruction_error(face) > 0


def test_the_exr_holds_all_numbers(tmp_path: Path, picture: Path, weights: Path) -> None:
    [face] = decompose_files([picture], tmp_path / "out", weights)
    channels, strings = read_exr(tmp_path / "out/face/decomposition.exr")
    np.testing.assert_allclose(json.loads(strings["sfsnet_dr:light"]), face.light.flat())
    assert len(strings["sfsnet_dr:weights_sha256"]) == 64
    for name, letters, array in (
        ("image", "RGB", face.image), ("normal", "XYZ", face.normal), ("albedo", "RGB", face.albedo),
        ("shading", "RGB", face.shading), ("reconstruction", "RGB", face.reconstruction),
    ):  # fmt: skip
        stored = np.stack([channels[f"{name}.{letter}"] for letter in letters], axis=-1)
        # Half floats keep 11 bits: relative 2^-11, and 2^-25 next to zero.
        np.testing.assert_allclose(stored, array, rtol=2**-11, atol=2**-24)
    np.testing.assert_allclose(channels["mask.Y"], face_ellipse_mask(), atol=2**-11)


def test_a_second_run_replaces_the_first_and_repeats_it(tmp_path: Path, picture: Path, weights: Path) -> None:
    decompose_files([picture], tmp_path / "out", weights)
    before = {p.name: p.read_bytes() for p in (tmp_path / "out/face").iterdir()}
    decompose_files([picture], tmp_path / "out", weights)
    assert {p.name: p.read_bytes() for p in (tmp_path / "out/face").iterdir()} == before
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["face"]


def test_eyes_and_side_file_give_the_same(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).uniform(size=(160, 160, 3))
    write_png(tmp_path / "big.png", pixels)
    given = read_photograph(tmp_path / "big.png", EYES)
    (tmp_path / "big.toml").write_text("eye_image_left = [58, 66]\neye_image_right = [102, 66]\n")
    found = read_photograph(tmp_path / "big.png")
    assert given.image.shape == (128, 128, 3)
    assert (given.image == found.image).all()
    assert (given.mask == found.mask).all()
    assert parse_eyes("--eyes", "58,66, 102,66") == EYES


def test_a_mask_comes_along_into_the_face_frame(tmp_path: Path) -> None:
    write_png(tmp_path / "big.png", np.full((160, 160, 3), 0.5))
    left_half = np.zeros((160, 160, 3))
    left_half[:, :80] = 1
    write_png(tmp_path / "mask.png", left_half)
    mask = read_photograph(tmp_path / "big.png", EYES, tmp_path / "mask.png").mask
    # The middle between the eyes, x = 80 there, is x = 64 in the face frame.
    assert (mask[20:110, 20:63] == 1).all()
    assert (mask[:, 65:] == 0).all()


def test_where_the_photograph_ends_the_mask_ends(tmp_path: Path) -> None:
    write_png(tmp_path / "cut.png", np.full((160, 80, 3), 0.5))
    mask = read_photograph(tmp_path / "cut.png", ((20.0, 66.0), (64.0, 66.0))).mask
    assert mask[70, 64] == 1
    assert (mask[:, 100:] == 0).all()
    assert face_ellipse_mask()[70, 100] == 1


def test_nothing_is_left_when_writing_fails(
    tmp_path: Path, picture: Path, weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> bytes:
        raise OSError("disk full")

    monkeypatch.setattr(outputs, "draw_sheet", fail)
    with pytest.raises(OSError, match="disk full"):
        decompose_files([picture], tmp_path / "out", weights)
    assert list((tmp_path / "out").iterdir()) == []


def test_an_earlier_result_outlives_a_failure(
    tmp_path: Path, picture: Path, weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    decompose_files([picture], tmp_path / "out", weights)
    monkeypatch.setattr(outputs, "write_exr", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        decompose_files([picture], tmp_path / "out", weights)
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["face"]
    assert {p.name for p in (tmp_path / "out/face").iterdir()} == FILES


def test_a_folder_of_somebody_else_is_not_touched(tmp_path: Path, picture: Path, weights: Path) -> None:
    (tmp_path / "out/face").mkdir(parents=True)
    (tmp_path / "out/face/thesis.txt").write_text("do not lose me")
    with pytest.raises(InputError, match=r"holds 'thesis\.txt'"):
        decompose_files([picture], tmp_path / "out", weights)
    assert (tmp_path / "out/face/thesis.txt").read_text() == "do not lose me"
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["face"]


def test_two_pictures_of_one_name_are_refused(tmp_path: Path, picture: Path, weights: Path) -> None:
    (tmp_path / "b").mkdir()
    twin = tmp_path / "b/face.png"
    twin.write_bytes(picture.read_bytes())
    with pytest.raises(InputError, match="2 are called 'face'"):
        decompose_files([picture, twin], tmp_path / "out", weights)
    assert not (tmp_path / "out").exists()


def recipe_metadata(size: int, values: str) -> dict[str, object]:
    """What `sfsnet-dr train` stores with weights, as far as images are concerned."""
    return {"recipe": {"data": {"size": size}, "real": {"values": values}}}


def test_a_network_answers_at_the_size_it_was_trained_at(tmp_path: Path, picture: Path) -> None:
    torch.manual_seed(0)
    model = SkipNet(4, 64)
    *_, bias = model.normal_decoder.parameters()
    torch.nn.init.constant_(bias, 0.5)
    save_weights(tmp_path / "w.safetensors", model, recipe_metadata(64, "linear"))
    [face] = decompose_files([picture], tmp_path / "out", tmp_path / "w.safetensors")
    assert face.normal.shape == face.image.shape == (128, 128, 3)
    blocks = read_image(picture).pixels.reshape(64, 2, 64, 2, 3).mean((1, 3))
    small = predict_with_flip_tta(
        model, torch.from_numpy(np.moveaxis(blocks, -1, 0)[None].astype(np.float32))
    )
    # Means over blocks of an image interpolated to twice its size: the middle of each block weighs 9/16, its
    # neighbours the rest, so on a smooth image the means are the image.
    inner = face.albedo[2:-2, 2:-2].reshape(62, 2, 62, 2, 3).mean((1, 3))
    wanted = np.moveaxis(small.albedo[0].numpy(), 0, -1)[1:-1, 1:-1]
    assert np.corrcoef(inner.ravel(), wanted.ravel())[0, 1] > 0.9
    np.testing.assert_allclose(np.linalg.norm(face.normal, axis=-1), 1, atol=1e-5)


def test_display_referred_weights_see_and_explain_the_encoded_picture(tmp_path: Path, picture: Path) -> None:
    """The paper's form: albedo times shading is what the file holds, and errors are of that."""
    weights = tmp_path / "w.safetensors"
    torch.manual_seed(0)
    model = SfSNet(4, 4, 1).eval()
    *_, bias = model.normal_head.parameters()
    torch.nn.init.constant_(bias, 0.5)
    save_weights(weights, model, recipe_metadata(128, "srgb"))
    [face] = decompose_files([picture], tmp_path / "out", weights)
    encoded = linear_to_srgb(read_image(picture).pixels)
    result = predict_with_flip_tta(
        model, torch.from_numpy(np.moveaxis(encoded, -1, 0)[None].astype(np.float32))
    )
    # Sums of float32 in another order, divided by short normals.
    np.testing.assert_allclose(face.albedo, np.moveaxis(result.albedo[0].numpy(), 0, -1), atol=1e-5)
    shown = face.albedo * face.shading
    np.testing.assert_allclose(linear_to_srgb(face.reconstruction), shown, atol=1e-9)
    inside = face.mask[..., None] * np.ones(3)
    expected = np.average(255 * np.abs(np.clip(shown, 0, 1) - encoded), weights=inside)
    assert reconstruction_error(face) == pytest.approx(expected, rel=1e-6)
    _, strings = read_exr(tmp_path / "out/face/decomposition.exr")
    assert strings["sfsnet_dr:values"] == "srgb"
    albedo = linear_to_srgb(read_image(tmp_path / "out/face/albedo.png").pixels)
    centre = (64, 64)
    np.testing.assert_allclose(albedo[centre], np.clip(face.albedo[centre], 0, 1), atol=0.5 / 255)
