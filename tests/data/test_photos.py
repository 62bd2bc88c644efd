"""Photographs as training data: what is listed, where it lies, what is told of the rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.image_io import write_png
from sfsnet_dr.data.alignment import canonical_landmarks, eye_centres, skin_mask
from sfsnet_dr.data.photos import list_photos, load_photos, split_holdout
from sfsnet_dr.data.transforms.crop import Crop

Array = npt.NDArray[np.float64]


def face_points() -> Array:
    """Landmarks of a plain upright face in the frame of 160 x 160 with eyes at (58, 66) and (102, 66)."""
    points = np.zeros((68, 2))
    angle = np.linspace(np.pi, 0, 17)
    points[:17] = np.stack([80 + 50 * np.cos(angle), 66 + 80 * np.sin(angle)], -1)
    points[17:36] = [80, 90]
    round_ = 2 * np.pi * np.arange(6) / 6
    for begin, x in ((36, 58), (42, 102)):
        points[begin : begin + 6] = np.stack([x + 7 * np.cos(round_), 66 + 3 * np.sin(round_)], -1)
    points[48:60] = [80, 118]
    round_ = 2 * np.pi * np.arange(8) / 8
    points[60:] = np.stack([80 + 10 * np.cos(round_), 118 + 5 * np.sin(round_)], -1)
    return points


def write_photos(folder: Path, count: int, points: Array | None = None) -> Path:
    """Photographs of 160 x 160 with landmarks beside their folder."""
    folder.mkdir(parents=True)
    names = [f"{number:03d}.png" for number in range(count)]
    for number, name in enumerate(names):
        rng = np.random.default_rng(number)
        write_png(folder / name, rng.uniform(0.1, 0.7, 3) * np.ones((160, 160, 1)))
    every = np.tile(face_points() if points is None else points, (count, 1, 1)).astype(np.float16)
    np.savez(folder.with_name(f"{folder.name}_landmarks.npz"), files=np.array(names), points=every)
    return folder


def test_the_known_frame_is_scaled_by_38_to_44() -> None:
    points = face_points()
    assert np.allclose(eye_centres(points), ((58, 66), (102, 66)))
    expected = np.array([45.0, 48.0]) + (points - [58, 66]) * 38 / 44
    np.testing.assert_allclose(canonical_landmarks(points), expected, atol=1e-9)


def test_a_turned_face_comes_upright() -> None:
    turn = np.exp(0.3j) * 1.7
    places = (face_points() @ [1, 1j]) * turn + (20 + 30j)
    turned = np.stack([places.real, places.imag], -1)
    np.testing.assert_allclose(canonical_landmarks(turned), canonical_landmarks(face_points()), atol=1e-9)


@pytest.mark.parametrize("size", [128, 64, 16])
def test_the_mask_is_the_face_without_eyes_and_mouth(size: int) -> None:
    """Against areas in closed form: two half ellipses less two grown hexagons and an octagon."""
    mask = skin_mask(canonical_landmarks(face_points()), size)
    scale = (38 / 44) ** 2
    jaw, forehead = np.pi / 2 * 50 * 80, np.pi / 2 * 50 * 0.45 * 80
    hexagon, octagon = 1.5 * np.sqrt(3) * 7 * 3, 2 * np.sqrt(2) * 10 * 5
    area = scale * (jaw + forehead - 2 * 1.3**2 * hexagon - octagon)
    # The jaw is 16 chords of its half ellipse: 0.6 % less; the fine grid adds its own half per cent.
    assert mask.sum() * (128 / size) ** 2 == pytest.approx(area, rel=0.012)
    if size == 128:
        assert mask[48, 45] == mask[48, 83] == 0  # eyes
        assert mask[int(48 + (118 - 66) * 38 / 44), 64] == 0  # mouth
        assert mask[30, 64] == mask[70, 64] == mask[112, 64] == 1  # forehead, nose, chin
        assert mask[5, 64] == mask[64, 5] == 0


def test_a_constant_picture_stays_what_it_is(tmp_path: Path) -> None:
    photos, skipped = list_photos(write_photos(tmp_path / "p", 2))
    loaded = load_photos(photos, Crop(32))
    assert not skipped
    assert not loaded.skipped
    assert tuple(loaded.images.shape) == (2, 3, 32, 32)
    for number in range(2):
        from sfsnet_dr.core.color import linear_to_srgb

        color = linear_to_srgb(np.random.default_rng(number).uniform(0.1, 0.7, 3)) * 255
        # One unit: 8 bits once in the file, once in memory.
        difference = np.abs(loaded.images[number].numpy().astype(float) - color[:, None, None])
        assert difference.max() <= 1.0


def test_what_cannot_be_used_is_told_and_left_out(tmp_path: Path) -> None:
    folder = write_photos(tmp_path / "p", 5)
    with np.load(tmp_path / "p_landmarks.npz") as file:
        files, points = file["files"][:4], file["points"][:4]
    points[1] = np.nan
    np.savez(tmp_path / "p_landmarks.npz", files=files, points=points)
    (folder / "002.png").write_bytes(b"this is no picture")
    photos, skipped = list_photos(folder)
    assert [(s.name, s.reason.split()[1]) for s in skipped] == [("001.png", "landmarks"), ("004.png", "name")]
    loaded = load_photos(photos, Crop(16))
    assert loaded.names == ("000.png", "003.png")
    assert [s.name for s in loaded.skipped] == ["002.png"]
    assert "002.png" in loaded.skipped[0].reason


def test_folders_of_folders_are_joined(tmp_path: Path) -> None:
    write_photos(tmp_path / "all" / "b", 1)
    write_photos(tmp_path / "all" / "a", 2)
    photos, _ = list_photos(tmp_path / "all")
    assert [photo.name for photo in photos] == ["a/000.png", "a/001.png", "b/000.png"]


def test_the_split_keeps_its_mind(tmp_path: Path) -> None:
    photos, _ = list_photos(write_photos(tmp_path / "p", 20))
    train, held = split_holdout(photos, 5)
    assert len(held) == 5
    assert {p.name for p in train} | {p.name for p in held} == {p.name for p in photos}
    again = split_holdout(photos[:-1], 5)[1]
    assert len({p.name for p in held} & {p.name for p in again}) >= 4  # one more may move up
    assert {p.name for p in split_holdout(photos, 5, seed=1)[1]} != {p.name for p in held}
    with pytest.raises(InputError, match="10 of 20 photographs"):
        split_holdout(photos, 10)


def without_landmarks(folder: Path) -> Path:
    write_photos(folder / "p", 1)
    (folder / "p_landmarks.npz").unlink()
    return folder / "p"


def damaged_landmarks(folder: Path) -> Path:
    write_photos(folder / "p", 1)
    (folder / "p_landmarks.npz").write_bytes(b"PK\x03\x04 no archive")
    return folder / "p"


def few_points(folder: Path) -> Path:
    write_photos(folder / "p", 1)
    np.savez(folder / "p_landmarks.npz", files=np.array(["000.png"]), points=np.zeros((1, 5, 2)))
    return folder / "p"


def no_face(folder: Path) -> Path:
    return write_photos(folder / "p", 2, np.full((68, 2), np.nan))


def empty(folder: Path) -> Path:
    (folder / "p").mkdir()
    return folder / "p"


def mixed_with_bundles(folder: Path) -> Path:
    (write_photos(folder / "p", 1) / "face-000001.exr").touch()
    return folder / "p"


def mixed_depths(folder: Path) -> Path:
    write_photos(folder / "p", 1)
    write_photos(folder / "p" / "q", 1)
    return folder / "p"


def missing(folder: Path) -> Path:
    return folder / "absent"


BAD = {
    without_landmarks: "no landmarks found",
    damaged_landmarks: "p_landmarks.npz: no landmarks",
    few_points: r"points of shape \(1, 5, 2\) found",
    no_face: "none of 2 photographs has landmarks",
    empty: "no photographs found",
    mixed_with_bundles: "face-000001.exr found among photographs",
    mixed_depths: "in it and in q/",
    missing: "no such folder",
}


@pytest.mark.parametrize("case", BAD, ids=lambda case: case.__name__)
def test_bad_folders_are_told_in_one_line(case: object, tmp_path: Path) -> None:
    assert callable(case)
    with pytest.raises(InputError, match=BAD[case]) as error:
        list_photos(case(tmp_path))
    assert "\n" not in str(error.value)
