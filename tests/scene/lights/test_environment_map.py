from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.image_io import write_exr, write_png
from sfsnet_dr.scene.lights.environment_map import MOST, list_maps, load_environment, split_lamps
from sfsnet_dr.scene.lights.equirect import pixel_directions, pixel_solid_angles
from sfsnet_dr.sh.coefficients import Radiance
from sfsnet_dr.sh.projection import equirect_solid_angles

SIZE = (64, 128)
Array = NDArray[np.float64]


def sky() -> Array:
    height = pixel_directions(*SIZE)[..., 1:2]
    return np.asarray((1 + 0.5 * height) * np.array([0.4, 0.5, 0.7]))


def with_sun(row: int, column: int, radiance: float) -> Array:
    picture = sky()
    for down in (0, 1):
        for right in (0, 1):
            picture[row + down, (column + right) % SIZE[1]] = radiance * np.array([1.0, 0.9, 0.7])
    return picture


def write_map(path: Path, picture: Array) -> Path:
    write_exr(path, {name: picture[..., k] for k, name in enumerate("RGB")}, {}, float32={"R", "G", "B"})
    return path


@pytest.mark.parametrize("column", [20, 127])
def test_a_sun_becomes_a_directional_light(column: int) -> None:
    picture = with_sun(18, column, 2000.0)
    rest, lamps = split_lamps(picture)
    (direction, power), angles = lamps[0], pixel_solid_angles(*SIZE)
    assert len(lamps) == 1
    corners = pixel_directions(*SIZE)[18:20][:, [column, (column + 1) % 128]].reshape(-1, 3)
    middle = corners.mean(axis=0) / np.linalg.norm(corners.mean(axis=0))
    # The rows' solid angles differ by 3 %, which moves the middle by a hundredth of a pixel of 2.8 degrees.
    assert np.degrees(np.arccos(direction @ middle)) < 0.05
    total = np.einsum("hw,hwc->c", angles, picture)
    np.testing.assert_allclose(np.einsum("hw,hwc->c", angles, rest) + power, total, rtol=1e-12)
    assert rest.min() > 0
    # The threshold: 20 times the sky's mean, of which its brightest hundredth, 0.4 % of the mean, is left
    # out.
    mean = np.average(sky() @ LUMINANCE, weights=angles)
    assert (rest @ LUMINANCE).max() == pytest.approx(20 * mean, rel=0.01)


def test_what_is_large_or_weak_stays_in_the_map() -> None:
    window = sky()
    window[20:32, 30:42] = 300.0  # 34 degrees wide
    assert split_lamps(window)[1] == ()
    firefly = sky()
    firefly[30, 30] = 40.0  # 2 % of all light
    assert split_lamps(firefly)[1] == ()
    np.testing.assert_array_equal(split_lamps(firefly)[0], firefly)


def test_only_the_strongest_of_many_lamps_leave() -> None:
    picture = 0.1 * sky()
    for k in range(6):
        picture[20, 10 + 20 * k] = 100.0 + 10 * k
    rest, lamps = split_lamps(picture)
    powers = [float(power @ LUMINANCE) for _, power in lamps]
    assert len(lamps) == MOST
    assert powers == sorted(powers, reverse=True)
    assert rest[20, 10].tolist() == [100.0] * 3


def test_splitting_lets_four_bands_hold_the_map() -> None:
    """The share of the map's square integral that order 4 holds: what truncation leaves out."""

    def held(picture: Array) -> float:
        angles, directions = pixel_solid_angles(*SIZE), pixel_directions(*SIZE)
        from sfsnet_dr.sh.basis import sh_basis

        values = np.einsum("hwk,hw,hwc->kc", sh_basis(directions, 4), angles, picture)
        return float((Radiance(values).values ** 2).sum() / np.einsum("hw,hwc->", angles, picture**2))

    picture = with_sun(18, 20, 2000.0)
    assert held(picture) < 0.1
    assert held(split_lamps(picture)[0]) > 0.8


def test_a_file_gives_its_light(tmp_path: Path) -> None:
    picture = with_sun(18, 20, 2000.0)
    light = load_environment(write_map(tmp_path / "noon.exr", picture))
    assert light.name == "noon"
    assert light.environment is not None
    total = np.einsum("hw,hwc->c", equirect_solid_angles(64, 128), light.environment)
    total = total + light.directional[0][1]
    expected = np.einsum("hw,hwc->c", pixel_solid_angles(*SIZE), picture)
    # Row integrals of the resampling by midpoints: 1.5e-5 seen, times 3.
    np.testing.assert_allclose(total, expected, rtol=5e-5)
    # A sun left of the middle shines from the image's right: +x.
    assert light.directional[0][0][0] > 0.5


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    import os

    path = write_map(tmp_path / "a.exr", sky())
    first = load_environment(path)
    assert load_environment(path) is first
    write_map(path, 2 * sky())
    os.utime(path, ns=(1, 1))
    second = load_environment(path)
    assert second.environment is not None
    np.testing.assert_allclose(second.environment, 2 * np.asarray(first.environment), rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: -p, "negative"),
        (lambda p: 0 * p, "black"),
        (lambda p: p[:, :100], "twice as wide"),
        (lambda p: p[:8, :16], "at least 16"),
    ],
)
def test_a_wrong_map_is_refused(tmp_path: Path, change: object, words: str) -> None:
    path = write_map(tmp_path / "wrong.exr", change(sky()))  # type: ignore[operator]
    with pytest.raises(InputError, match=words) as caught:
        load_environment(path)
    assert str(path) in str(caught.value)


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    empty, missing, cut = tmp_path / "empty.exr", tmp_path / "missing.exr", tmp_path / "cut.exr"
    empty.write_bytes(b"")
    whole = write_map(tmp_path / "whole.exr", sky()).read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    for path in (empty, missing, cut):
        with pytest.raises(InputError, match=path.name):
            load_environment(path)
    png = tmp_path / "low.png"
    write_png(png, np.clip(sky(), 0, 1))
    with pytest.raises(InputError, match="8-bit"):
        load_environment(png)


def test_a_nan_is_refused(tmp_path: Path) -> None:
    import OpenImageIO as oiio

    picture = sky().astype(np.float32)
    picture[3, 4] = np.nan
    path = tmp_path / "nan.exr"
    output = oiio.ImageOutput.create(str(path))
    assert output is not None
    output.open(str(path), oiio.ImageSpec(128, 64, 3, oiio.FLOAT))
    output.write_image(picture)
    output.close()
    with pytest.raises(InputError, match="NaN"):
        load_environment(path)


def test_folders_list_their_maps(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no environment map"):
        list_maps(tmp_path)
    for name in ("b.exr", "a.hdr", "c.txt"):
        (tmp_path / name).touch()
    assert [path.name for path in list_maps(tmp_path)] == ["a.hdr", "b.exr"]
    with pytest.raises(InputError, match="no such folder"):
        list_maps(tmp_path / "none")
