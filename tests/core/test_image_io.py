"""Files by one library, read back by another: Pillow is the oracle for PNG and JPEG."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import PIL.Image
import PIL.ImageOps
import pytest
from helpers.disks import files_up_to
from numpy.typing import NDArray

from sfsnet_dr.core.color import linear_to_srgb, srgb_to_linear
from sfsnet_dr.core.errors import InputError, RunError
from sfsnet_dr.core.image_io import read_exr, read_image, write_exr, write_png


def codes(height: int = 6, width: int = 7, channels: int = 3) -> NDArray[np.uint8]:
    return np.random.default_rng(1).integers(0, 256, (height, width, channels), dtype=np.uint8)


def linear(encoded: NDArray[Any]) -> NDArray[np.float64]:
    return srgb_to_linear(encoded / 255)


def test_png_is_decoded_to_linear_light(tmp_path: Path) -> None:
    pixels, path = codes(), tmp_path / "a.png"
    PIL.Image.fromarray(pixels).save(path)
    image = read_image(path)
    assert image.was_srgb
    assert image.pixels.dtype == np.float32
    np.testing.assert_allclose(image.pixels, linear(pixels), rtol=1e-6, atol=1e-7)  # float32


def test_every_code_survives_reading_and_writing(tmp_path: Path) -> None:
    pixels = np.arange(256, dtype=np.uint8)[None, :, None].repeat(3, axis=2)
    PIL.Image.fromarray(pixels).save(tmp_path / "a.png")
    write_png(tmp_path / "b.png", read_image(tmp_path / "a.png").pixels)
    np.testing.assert_array_equal(np.asarray(PIL.Image.open(tmp_path / "b.png")), pixels)


def test_written_png_clips_rounds_and_keeps_its_text(tmp_path: Path) -> None:
    values = np.array([[[-1.0, 0.25, 7.0]]])
    write_png(tmp_path / "a.png", values, {"sfsnet_dr:seed": "7"})
    image = PIL.Image.open(tmp_path / "a.png")
    assert np.asarray(image).tolist() == [
        [[0, 137, 255]]
    ]  # 1.055 * 0.25^(1/2.4) - 0.055 = 0.5371 = 136.96 / 255
    assert image.info["sfsnet_dr:seed"] == "7"
    assert read_image(tmp_path / "a.png").metadata["sfsnet_dr:seed"] == "7"


def test_display_values_get_no_curve(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.full((2, 2, 3), 0.2), encoded=True)
    assert np.asarray(PIL.Image.open(tmp_path / "a.png"))[0, 0, 0] == 51


def test_jpeg(tmp_path: Path) -> None:
    pixels = np.full((16, 16, 3), (200, 120, 90), dtype=np.uint8)
    PIL.Image.fromarray(pixels).save(tmp_path / "a.jpg", quality=95)
    decoded = np.asarray(PIL.Image.open(tmp_path / "a.jpg"))
    # Two JPEG decoders may differ by one code.
    found = linear_to_srgb(read_image(tmp_path / "a.jpg").pixels) * 255
    np.testing.assert_allclose(found, decoded, atol=1.01)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_turned_upright_as_exif_says(tmp_path: Path, orientation: int) -> None:
    source = PIL.Image.fromarray(codes(4, 6))
    exif = PIL.Image.Exif()
    exif[0x0112] = orientation
    source.save(tmp_path / "a.png", exif=exif)
    upright = np.asarray(PIL.ImageOps.exif_transpose(PIL.Image.open(tmp_path / "a.png")))
    np.testing.assert_allclose(read_image(tmp_path / "a.png").pixels, linear(upright), rtol=1e-5, atol=1e-6)


def test_16_bit_grey(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 65536, (4, 5), dtype=np.uint16)
    PIL.Image.fromarray(pixels).save(tmp_path / "a.png")
    expected = srgb_to_linear(pixels / 65535)
    assert read_image(tmp_path / "a.png").pixels.shape == (4, 5, 1)
    image = read_image(tmp_path / "a.png", channels=3)
    np.testing.assert_allclose(image.pixels, np.repeat(expected[..., None], 3, axis=2), rtol=1e-5, atol=1e-7)


def test_png_alpha_is_dropped_without_darkening(tmp_path: Path) -> None:
    pixels = codes(channels=4)
    PIL.Image.fromarray(pixels).save(tmp_path / "a.png")
    np.testing.assert_allclose(
        read_image(tmp_path / "a.png").pixels, linear(pixels[..., :3]), rtol=1e-5, atol=1e-6
    )


def test_exr_alpha_is_divided_out(tmp_path: Path) -> None:
    alpha = np.array([[1.0, 0.5, 0.0]])
    names = {"R": 0.25 * alpha, "G": 0.5 * alpha, "B": 1.0 * alpha, "A": alpha}
    write_exr(tmp_path / "a.exr", names, {})
    image = read_image(tmp_path / "a.exr")
    assert not image.was_srgb
    np.testing.assert_array_equal(image.pixels[0], [[0.25, 0.5, 1], [0.25, 0.5, 1], [0, 0, 0]])


def test_exr_there_and_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    planes = {
        f"transport.{k:02d}.{c}": rng.normal(size=(5, 6)).astype(np.float32) for k in range(9) for c in "RGB"
    }
    planes["variance.R"] = np.full((5, 6), 1e-9, dtype=np.float32)
    write_exr(tmp_path / "a.exr", planes, {"sfsnet_dr:spec": '{"a": "é"}'}, {"variance.R"})
    found, metadata = read_exr(tmp_path / "a.exr")
    assert set(found) == set(planes)
    assert metadata["sfsnet_dr:spec"] == '{"a": "é"}'
    np.testing.assert_array_equal(found["variance.R"], planes["variance.R"])  # as half it would be 0
    for name in set(planes) - {"variance.R"}:
        np.testing.assert_array_equal(found[name], planes[name].astype(np.float16).astype(np.float32))


@pytest.mark.parametrize("float32", [(), ("a",), ("a", "b")])
def test_exr_channels_have_the_precision_that_was_asked_for(tmp_path: Path, float32: tuple[str, ...]) -> None:
    third = np.full((2, 2), 1 / 3, dtype=np.float32)
    write_exr(tmp_path / "a.exr", {"a": third, "b": third}, {}, float32)
    found, _ = read_exr(tmp_path / "a.exr")
    for name in ("a", "b"):
        kept = third if name in float32 else third.astype(np.float16).astype(np.float32)
        np.testing.assert_array_equal(found[name], kept)


def test_exr_bytes_depend_on_the_content_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither on the hour nor on the order of the channels."""
    planes = {"b": np.ones((2, 2)), "a": np.zeros((2, 2))}
    write_exr(tmp_path / "a.exr", planes, {"k": "v"})
    write_exr(tmp_path / "b.exr", dict(reversed(planes.items())), {"k": "v"})
    first = (tmp_path / "a.exr").read_bytes()
    assert first == (tmp_path / "b.exr").read_bytes()
    assert b"capDate" not in first  # the name under which EXR keeps the hour
    assert b"DateTime" not in first


def damaged(tmp_path: Path, kind: str) -> Path:
    """A file that cannot be read, of the kind named."""
    path = tmp_path / f"bad{'.jpg' if 'jpg' in kind else '.png'}"
    if kind == "folder":
        path.mkdir()
    elif kind != "missing":
        PIL.Image.fromarray(codes(64, 64)).save(path)
        data = path.read_bytes()
        broken = {
            "empty": b"",
            "text": b"hello",
            "png half": data[: len(data) // 2],
            "png without end": data[:-12],
            "png flipped byte": data[:100] + bytes([data[100] ^ 1]) + data[101:],
            "jpg half": data[: len(data) // 2],
        }
        path.write_bytes(broken[kind])
    return path


@pytest.mark.parametrize(
    "kind",
    ["missing", "folder", "empty", "text", "png half", "png without end", "png flipped byte", "jpg half"],
)
def test_unreadable_file(tmp_path: Path, kind: str, capfd: pytest.CaptureFixture[str]) -> None:
    path = damaged(tmp_path, kind)
    with pytest.raises(InputError) as caught:
        read_image(path)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    assert capfd.readouterr() == ("", "")  # no library prints beside it


@pytest.mark.parametrize("count", [2, 5])
def test_wrong_channel_count(tmp_path: Path, count: int) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, {name: np.ones((2, 2)) for name in "ABCDE"[:count]}, {})
    with pytest.raises(InputError, match=rf"{count} channels found, 1 \(grey\), 3 \(RGB\) or 4"):
        read_image(path)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_not_finite(tmp_path: Path, bad: float) -> None:
    pixels = np.ones((2, 2, 3), dtype=np.float32)
    pixels[1, 1, 2] = bad
    spec = oiio.ImageSpec(2, 2, 3, "float")
    target = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    assert target is not None
    target.open(str(tmp_path / "a.exr"), spec)
    target.write_image(pixels)
    target.close()
    with pytest.raises(InputError, match="NaN or inf in 1 of 12 values"):
        read_image(tmp_path / "a.exr")
    with pytest.raises(InputError, match="channel x: NaN or inf"):
        write_exr(tmp_path / "b.exr", {"x": pixels[..., 2]}, {})
    with pytest.raises(InputError, match="NaN or inf"):
        write_png(tmp_path / "b.png", pixels)
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]


def test_read_exr_refuses_a_png(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.ones((2, 2, 3)))
    with pytest.raises(InputError, match="png file found, openexr expected"):
        read_exr(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("channels", "float32", "message"),
    [
        ({}, (), r"channels of shapes \[\] found"),
        ({"a": np.ones((2, 2)), "b": np.ones((2, 3))}, (), "channels of shapes"),
        ({"a": np.ones((2, 2, 3))}, (), "channels of shapes"),
        ({"a": np.ones((2, 2))}, ("b",), r"float32 names \['b'\]"),
        ({"a": np.full((2, 2), 7e4)}, (), "channel a: 70000 found, half floats reach 65504"),
    ],
)
def test_write_exr_refuses(
    tmp_path: Path, channels: dict[str, NDArray[Any]], float32: tuple[str, ...], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        write_exr(tmp_path / "a.exr", channels, {}, float32)
    assert not list(tmp_path.iterdir())


def test_unwritable_output(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write_png(tmp_path / "no" / "a.png", np.ones((2, 2, 3)))
    with pytest.raises(InputError, match=r"use \.png or \.exr"):
        write_png(tmp_path / "a.nonsense", np.ones((2, 2, 3)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_the_order_of_an_array_in_memory_does_not_matter(tmp_path: Path, suffix: str) -> None:
    pixels = np.random.default_rng(1).random((3, 5, 4))  # channels first, as torch has them
    written = []
    for k, array in enumerate((np.moveaxis(pixels, 0, -1), np.moveaxis(pixels, 0, -1).copy())):
        path = tmp_path / f"{k}{suffix}"
        if suffix == ".png":
            write_png(path, array)
        else:
            write_exr(path, {name: array[..., c].T.copy().T for c, name in enumerate("RGB")}, {})
        written.append(path.read_bytes())
    assert written[0] == written[1]


@pytest.mark.parametrize("missing", [1, 100, 3000])
@pytest.mark.parametrize("suffix", [".exr", ".png"])
def test_a_full_disk_is_told_whatever_it_cuts_off(tmp_path: Path, suffix: str, missing: int) -> None:
    """OpenImageIO alone is silent about the last buffer of an EXR."""
    pixels = np.random.default_rng(0).random((64, 64, 3))

    def write(path: Path) -> None:
        if suffix == ".png":
            write_png(path, pixels)
        else:
            write_exr(path, {name: pixels[..., c] for c, name in enumerate("RGB")}, {})

    whole, cut = tmp_path / f"whole{suffix}", tmp_path / f"cut{suffix}"
    write(whole)
    with (
        files_up_to(whole.stat().st_size - missing),
        pytest.raises(RunError, match=f"{cut}: writing failed"),
    ):
        write(cut)
    assert list(tmp_path.iterdir()) == [whole]
    write(cut)
    assert cut.read_bytes() == whole.read_bytes()
