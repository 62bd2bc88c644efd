"""Command lines that users get wrong, and what the one line of the answer must name; see ``test_cli.py``."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file

from sfsnet_dr.core.image_io import write_exr, write_png


def planes(count: int, value: float = 0.5) -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.float32]]]:
    return {name: np.full((128, 128), value, np.float32) for name in "ABCDEFG"[:count]}


def decompose(
    folder: Path, image: str = "face.png", *more: str, weights: str = "good.safetensors"
) -> list[str]:
    names = [str(folder / image), "--weights", str(folder / weights), "--out", str(folder / "out"), *more]
    return ["decompose", *names]


def missing(folder: Path) -> list[str]:
    return decompose(folder, "absent.png")


def undecodable(folder: Path) -> list[str]:
    (folder / "text.jpg").write_text("this is no picture")
    return decompose(folder, "text.jpg")


def no_bytes(folder: Path) -> list[str]:
    (folder / "empty.png").touch()
    return decompose(folder, "empty.png")


def wrong_size(folder: Path) -> list[str]:
    write_png(folder / "wide.png", np.full((100, 200, 3), 0.4))
    return decompose(folder, "wide.png")


def two_channels(folder: Path) -> list[str]:
    write_exr(folder / "two.exr", planes(2), {})
    return decompose(folder, "two.exr")


def five_channels(folder: Path) -> list[str]:
    write_exr(folder / "five.exr", planes(5), {})
    return decompose(folder, "five.exr")


def poisoned(folder: Path, value: float, name: str) -> list[str]:
    import OpenImageIO as oiio

    spec = oiio.ImageSpec(128, 128, 3, oiio.FLOAT)
    pixels = np.full((128, 128, 3), 0.5, np.float32)
    pixels[3, 4, 1] = value
    file = oiio.ImageOutput.create(str(folder / name))
    assert file is not None
    assert file.open(str(folder / name), spec)
    assert file.write_image(pixels)
    file.close()
    return decompose(folder, name)


def nan(folder: Path) -> list[str]:
    return poisoned(folder, float("nan"), "nan.exr")


def infinite(folder: Path) -> list[str]:
    return poisoned(folder, float("inf"), "inf.exr")


def other_architecture(folder: Path) -> list[str]:
    save_file({"a": torch.zeros(2)}, folder / "other.safetensors", {"sfsnet_dr": json.dumps(
        {"format": "sfsnet_dr.weights", "version": 1, "architecture": "resnet", "config": {}})})  # fmt: skip
    return decompose(folder, weights="other.safetensors")


def foreign_tensors(folder: Path) -> list[str]:
    save_file({"a": torch.zeros(2)}, folder / "foreign.safetensors")
    return decompose(folder, weights="foreign.safetensors")


def pickled(folder: Path) -> list[str]:
    (folder / "weights.pth").write_bytes(pickle.dumps({"a": 1}))
    return decompose(folder, weights="weights.pth")


def truncated(folder: Path) -> list[str]:
    data = (folder / "good.safetensors").read_bytes()
    (folder / "cut.safetensors").write_bytes(data[: len(data) // 2])
    return decompose(folder, weights="cut.safetensors")


def no_weights(folder: Path) -> list[str]:
    return decompose(folder, weights="absent.safetensors")


def output_below_a_file(folder: Path) -> list[str]:
    (folder / "file").touch()
    arguments = decompose(folder)
    return [*arguments[:-1], str(folder / "file" / "out")]


def output_is_a_file(folder: Path) -> list[str]:
    (folder / "file").touch()
    return [*decompose(folder)[:-1], str(folder / "file")]


def empty_mask(folder: Path) -> list[str]:
    write_png(folder / "black.png", np.zeros((128, 128, 3)))
    return decompose(folder, "face.png", "--mask", str(folder / "black.png"))


def mask_without_bytes(folder: Path) -> list[str]:
    (folder / "mask.png").touch()
    return decompose(folder, "face.png", "--mask", str(folder / "mask.png"))


def mask_of_another_size(folder: Path) -> list[str]:
    write_png(folder / "small.png", np.ones((64, 64, 3)))
    return decompose(folder, "face.png", "--mask", str(folder / "small.png"))


def eyes_that_are_no_numbers(folder: Path) -> list[str]:
    return decompose(folder, "face.png", "--eyes", "1,2,3")


def eyes_outside(folder: Path) -> list[str]:
    return decompose(folder, "face.png", "--eyes", "10,10,400,10")


def side_file_with_a_wrong_key(folder: Path) -> list[str]:
    (folder / "face.toml").write_text("eye_left = [45, 48]\neye_image_right = [83, 48]\n")
    return decompose(folder)


def no_image(folder: Path) -> list[str]:
    return ["decompose", "--weights", str(folder / "good.safetensors"), "--out", str(folder / "out")]


def unknown_recipe_key(folder: Path) -> list[str]:
    (folder / "recipe.toml").write_text("steps = 3\nbatch_sise = 2\n")
    return ["train", str(folder / "recipe.toml"), "--out", str(folder / "out")]


def missing_recipe(folder: Path) -> list[str]:
    return ["train", str(folder / "absent.toml"), "--out", str(folder / "out")]


def unknown_scene_key(folder: Path) -> list[str]:
    (folder / "scene.toml").write_text('name = "x"\nshape = "anny"\nalbido = [0.5, 0.5, 0.5]\n')
    return ["synth", "--scene", str(folder / "scene.toml"), "--out", str(folder / "out")]


def no_faces(folder: Path) -> list[str]:
    (folder / "scene.toml").write_text('name = "x"\nshape = "anny"\n')
    return ["synth", "--scene", str(folder / "scene.toml"), "--out", str(folder / "out"), "--count", "0"]


def photographs_without_landmarks(folder: Path) -> list[str]:
    (folder / "photos").mkdir()
    write_png(folder / "photos" / "a.png", np.full((160, 160, 3), 0.4))
    weights = str(folder / "good.safetensors")
    return ["pseudo-label", str(folder / "photos"), "--weights", weights, "--out", str(folder / "out")]


def empty_folder_of_photographs(folder: Path) -> list[str]:
    (folder / "photos").mkdir()
    weights = str(folder / "good.safetensors")
    return ["pseudo-label", str(folder / "photos"), "--weights", weights, "--out", str(folder / "out")]


def unknown_command(_: Path) -> list[str]:
    return ["decompse"]


#: Bad input -> what the one line must name: the file or key, what was found, what is allowed.
BAD: dict[Callable[[Path], list[str]], tuple[str, ...]] = {
    missing: ("absent.png", "No such file", "existing image file"),
    undecodable: ("text.jpg", "cannot be decoded", "give an image file"),
    no_bytes: ("empty.png", "0 bytes", "image file is needed"),
    wrong_size: ("wide.png", "200 x 100", "128 x 128", "--eyes", "wide.toml"),
    two_channels: ("two.exr", "2 channels", "3 (RGB)"),
    five_channels: ("five.exr", "5 channels", "3 (RGB)"),
    nan: ("nan.exr", "NaN or inf in 1 of", "finite"),
    infinite: ("inf.exr", "NaN or inf in 1 of", "finite"),
    other_architecture: ("other.safetensors", "'resnet'", "sfsnet"),
    foreign_tensors: ("foreign.safetensors", "no format name", "sfsnet_dr.weights expected"),
    pickled: ("weights.pth", "not a safetensors file"),
    truncated: ("cut.safetensors", "not a safetensors file"),
    no_weights: ("absent.safetensors", "no such file", "sfsnet-dr train"),
    output_below_a_file: ("file/out", "cannot be written", "writable folder"),
    output_is_a_file: ("file", "is a file", "folder is needed"),
    empty_mask: ("black.png", "mask is empty", "one face pixel"),
    mask_without_bytes: ("mask.png", "0 bytes"),
    mask_of_another_size: ("small.png", "64 x 64", "128 x 128"),
    eyes_that_are_no_numbers: ("--eyes", "'1,2,3'", "four numbers"),
    eyes_outside: ("face.png", "(400, 10)", "128 x 128"),
    side_file_with_a_wrong_key: ("face.toml", "'eye_left'", "eye_image_left"),
    no_image: ("images", "none given", "one at least"),
    unknown_recipe_key: ("recipe.toml", "'batch_sise'", "'batch_size'"),
    missing_recipe: ("absent.toml", "no such file"),
    unknown_scene_key: ("scene.toml", "'albido'", "'albedo'"),
    no_faces: ("count 0", "at least 1"),
    photographs_without_landmarks: ("photos", "no landmarks found", "photos_landmarks.npz"),
    empty_folder_of_photographs: ("photos", "no photographs found", "JPEG or PNG"),
    unknown_command: ("'decompse'", "'decompose'"),
}
