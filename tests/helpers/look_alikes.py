"""Tiny folders that look like face databases: a lit sphere in place of a face."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from sfsnet_dr.data.databases.base import heading
from sfsnet_dr.data.databases.yale_b import CROP_EYES, CROP_SIZE

Array = npt.NDArray[np.float64]

#: Azimuth and elevation (degrees) of twelve lights.
ANGLES = [(a, e) for e in (-20, 0, 25) for a in (-50, -15, 15, 50)]


def ball(height: int, width: int) -> Array:
    """Normals (height, width, 3) of a sphere that fills the picture."""
    y, x = np.mgrid[0:height, 0:width] + 0.5
    x, y = (2 * x - width) / max(width, height) * 0.7, -(2 * y - height) / max(width, height) * 0.7
    return np.asarray(np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], -1), np.float64)


def lit(
    height: int, width: int, direction: tuple[float, float, float], albedo: float = 0.7
) -> npt.NDArray[np.uint8]:
    """8-bit linear picture (height, width) of that sphere under one light."""
    shade = np.maximum(ball(height, width) @ np.array(direction), 0)
    return np.asarray(np.rint(255 * albedo * shade), np.uint8)


def yale_name(subject: str, azimuth: int, elevation: int, suffix: str = ".pgm") -> str:
    """Name of a file."""
    return f"{subject}_P00A{azimuth:+04d}E{elevation:+03d}{suffix}"


def write_yale_b(folder: Path, subjects: int = 2, suffix: str = ".pgm") -> Path:
    """Subjects under twelve lights, each of another albedo."""
    width, height = CROP_SIZE
    for number in range(1, subjects + 1):
        part = folder / f"yaleB{number:02d}"
        part.mkdir(parents=True)
        for azimuth, elevation in ANGLES:
            picture = lit(height, width, heading(azimuth, elevation), 0.9 - 0.1 * number)
            Image.fromarray(picture).save(part / yale_name(part.name, azimuth, elevation, suffix))
    return folder


def crop_normals() -> Array:
    """The sphere's normals in the canonical frame, (128, 128, 3)."""
    from sfsnet_dr.data.alignment import resample_to_canonical

    width, height = CROP_SIZE
    normal = resample_to_canonical(ball(height, width), CROP_EYES).astype(np.float64)
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9))


def write_celeba(folder: Path, count: int = 4) -> Path:
    """Aligned pictures of 178 x 218 with the three lists, in the folders they are distributed in."""
    for part in ("Img/img_align_celeba", "Eval", "Anno"):
        (folder / part).mkdir(parents=True)
    names = [f"{number:06d}.jpg" for number in range(1, count + 1)]
    for name in names:
        Image.fromarray(np.full((218, 178, 3), 90, np.uint8)).save(folder / "Img/img_align_celeba" / name)
    lines = [f"{name} {index % 3}" for index, name in enumerate(names)]
    (folder / "Eval/list_eval_partition.txt").write_text("\n".join(lines) + "\n")
    lines = [f"{name} {7 + index // 2}" for index, name in enumerate(names)]
    (folder / "Anno/identity_CelebA.txt").write_text("\n".join(lines) + "\n")
    rows = [f"{name} 69 111 108 112 88 140 73 152 105 153" for name in names]
    titles = "lefteye_x lefteye_y righteye_x righteye_y nose_x nose_y ..."
    text = "\n".join([str(count), titles, *rows])
    (folder / "Anno/list_landmarks_align_celeba.txt").write_text(text + "\n")
    return folder


def write_photoface(folder: Path, captures: int = 1) -> Path:
    """Captures of one subject, each with four BMPs, the lights' angles and eleven landmarks."""
    zenith, azimuth = (40, 42, 38, 41), (45, 135, 225, 315)
    for number in range(captures):
        capture = folder / "1001" / f"2008-02-23_11-23-{number:02d}"
        capture.mkdir(parents=True)
        for light, (z, a) in enumerate(zip(zenith, azimuth, strict=True)):
            z_, a_ = np.radians(z), np.radians(a)
            direction = (np.sin(z_) * np.cos(a_), np.sin(z_) * np.sin(a_), np.cos(z_))
            Image.fromarray(lit(120, 100, direction)).save(capture / f"im{light}.bmp")
        lines = [f"zenith = {list(zenith)};", f"azimuth = {list(azimuth)};"]
        (capture / "LightSource.m").write_text("% lights\n" + "\n".join(lines) + "\n")
        points = [(25, 40), (41, 40), (50, 42), (59, 40), (75, 40), *[(50, 60 + k) for k in range(6)]]
        rows = [f"point{index} {x} {y}" for index, (x, y) in enumerate(points)]
        (capture / "metadata.txt").write_text("\n".join(rows) + "\n")
    return folder


def face_points(left: tuple[float, float] = (40, 50), right: tuple[float, float] = (62, 50)) -> Array:
    """68 landmarks of a face with these eyes, in the order of iBUG 300-W."""
    middle, unit = (left[0] + right[0]) / 2, right[0] - left[0]
    points = np.tile([[middle, left[1] + unit]], (68, 1))
    angle = np.linspace(np.pi, 2 * np.pi, 17)
    points[:17] = np.stack([middle + 1.1 * unit * np.cos(angle), left[1] - 1.8 * unit * np.sin(angle)], -1)
    circle = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    ring = 0.12 * unit * np.stack([np.cos(circle), 0.5 * np.sin(circle)], -1)
    points[36:42], points[42:48] = np.array(left) + ring, np.array(right) + ring
    return points


def write_multipie(folder: Path) -> Path:
    """Two subjects, three lights, two cameras, landmarks for the frontal one."""
    names = []
    for subject in ("001", "002"):
        for camera in ("051", "190"):
            part = folder / "session01" / "multiview" / subject / "01" / f"{camera[:2]}_{camera[2]}"
            part.mkdir(parents=True)
            for light in ("00", "07", "19"):
                name = f"{subject}_01_01_{camera}_{light}.png"
                Image.fromarray(np.full((96, 100, 3), 80, np.uint8)).save(part / name)
                names.append((part / name).relative_to(folder).as_posix())
    frontal = [name for name in names if "_051_" in name]
    np.savez(
        folder / "landmarks.npz", files=np.array(frontal), points=np.array([face_points()] * len(frontal))
    )
    return folder
