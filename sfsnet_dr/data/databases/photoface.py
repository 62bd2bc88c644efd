"""Photoface: four pictures of a capture, each under one lamp, for photometric stereo.

Folder: captures at any depth below it, each a folder with ``im0.bmp`` to ``im3.bmp``, ``LightSource.m`` and
``metadata.txt``; the folder above a capture is its subject. ``LightSource.m`` gives zenith (from the camera's
axis) and azimuth (from the image's right toward its top) of the four lights, as two assignments of four
numbers whose names begin with ``zen`` and ``az``; in degrees if a number is above 2 pi, else in radians.
``metadata.txt`` has a line a landmark that ends in x and y: outer and inner corner of the image's left eye,
root of the nose, inner and outer corner of its right eye, then nose, mouth and chin, eleven in all.

The database is given out on request only; this reader is held against look-alikes that a test writes by this
description. Values are taken for linear light, as of a camera for measurements.
Source: Zafeiriou et al., The Photoface database, CVPR Workshops 2011.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.alignment import Eyes
from sfsnet_dr.data.databases.base import FacePhoto, Listing, need_folder, sort_photos
from sfsnet_dr.data.photos import SkippedPhotos

NAME: Final = "photoface"

_PICTURES: Final = tuple(f"im{number}.bmp" for number in range(4))
_LANDMARKS: Final = 11
_NUMBER: Final = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def list_photoface(folder: Path | str) -> Listing:
    """The pictures of all whole captures.

    Raises:
        InputError: if the folder is missing or holds no whole capture.
    """
    folder = need_folder(folder)
    photos, skipped = [], []
    for lights in sorted(folder.rglob("LightSource.m")):
        capture = lights.parent
        name = capture.relative_to(folder).as_posix()
        try:
            photos += _capture(folder, capture)
        except InputError as error:
            skipped.append(SkippedPhotos(name, str(error)))
    return Listing(NAME, folder, sort_photos(photos), tuple(skipped), linear=True)


def _capture(folder: Path, capture: Path) -> list[FacePhoto]:
    for needed in (*_PICTURES, "metadata.txt"):
        if not (capture / needed).is_file():
            raise InputError(f"{needed} is missing")
    directions = _directions((capture / "LightSource.m").read_text(encoding="utf-8", errors="replace"))
    eyes = _eyes((capture / "metadata.txt").read_text(encoding="utf-8", errors="replace"))
    name = capture.relative_to(folder).as_posix()
    return [
        FacePhoto(f"{name}/{file}", capture / file, capture.parent.name, name, eyes, f"{number}", direction)
        for number, (file, direction) in enumerate(zip(_PICTURES, directions, strict=True))
    ]


def _directions(text: str) -> list[tuple[float, float, float]]:
    zenith, azimuth = _angles(text, "zen"), _angles(text, "az")
    return [
        (float(np.sin(z) * np.cos(a)), float(np.sin(z) * np.sin(a)), float(np.cos(z)))
        for z, a in zip(zenith, azimuth, strict=True)
    ]


def _angles(text: str, name: str) -> list[float]:
    found = re.search(rf"(?im)^\s*{name}\w*\s*=\s*\[?([^\];%]*)", text)
    numbers = [float(word) for word in _NUMBER.findall(found.group(1))] if found else []
    if len(numbers) != len(_PICTURES):
        raise InputError(f"LightSource.m: {len(numbers)} numbers of {name}... found, 4 are needed")
    in_degrees = max(abs(number) for number in numbers) > 2 * np.pi
    return [float(np.radians(number)) if in_degrees else number for number in numbers]


def _eyes(text: str) -> Eyes:
    rows = [[float(word) for word in _NUMBER.findall(line)][-2:] for line in text.splitlines()]
    points = [row for row in rows if len(row) == 2]
    if len(points) != _LANDMARKS:
        raise InputError(f"metadata.txt: {len(points)} landmarks found, {_LANDMARKS} are needed")
    (a, b), (c, d) = (points[0], points[1]), (points[3], points[4])
    left = ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)
    right = ((c[0] + d[0]) / 2, (c[1] + d[1]) / 2)
    return left, right
