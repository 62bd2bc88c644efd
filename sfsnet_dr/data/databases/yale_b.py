"""Extended Yale Face Database B: known lights, one grey 8-bit picture a light, linear in radiance.

Folder: a folder a subject, ``yaleB01`` to ``yaleB39``, with files such as ``yaleB01_P00A+035E+15.pgm`` (or
.png): subject, pose, azimuth and elevation of the light in degrees. Files that end in ``.bad`` were marked so
by the database's authors. Pictures without a lamp (``_Ambient``) belong to no light and are left out.

Convention: a positive azimuth lights the image's left side; the direction toward the light is
(-sin A cos E, sin E, cos A cos E) in the camera frame.

Source: Georghiades, Belhumeur, Kriegman 2001; cropped by Lee, Ho, Kriegman 2005.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.alignment import Eyes, read_eyes, side_file
from sfsnet_dr.data.databases.base import FacePhoto, Listing, heading, need_folder, sort_photos
from sfsnet_dr.data.photos import SkippedPhotos

NAME: Final = "yale-b"

#: Width and height of the cropped pictures, and where they have the eyes' centres: read off the mean picture
#: of 19 subjects; nose and mouth then fall where other photographs have them, within a pixel.
CROP_SIZE: Final = (168, 192)
CROP_EYES: Final[Eyes] = ((32.0, 44.5), (134.0, 44.5))

_FILE: Final = re.compile(r"(yaleB\d{2})_(P\d{2})A([+-]\d{3})E([+-]\d{2})\.(pgm|png)")
_SUBJECT: Final = re.compile(r"yaleB\d{2}")
_ASIDE: Final = frozenset({".info", ".txt", ".md", ".toml", ".npz"})

#: The lights of the 19-way classification. MultiPIE, whose protocol it follows, has 18 flashes, 13 of them in
#: a row at the height of the head from one side to the other and the rest above, and one picture without any.
#: Here eleven lights stand in that row, and eight above it; like there, neighbours are about 15 to 25 degrees
#: apart, and none is behind the head, from where only a rim is lit.
LIGHTS_19: Final = (
    "A-095E+00", "A-070E+00", "A-050E+00", "A-025E+00", "A-010E+00", "A+000E+00", "A+010E+00", "A+025E+00",
    "A+050E+00", "A+070E+00", "A+095E+00", "A-060E+20", "A-035E+15", "A+000E+20", "A+035E+15", "A+060E+20",
    "A-035E+40", "A+000E+45", "A+035E+40",
)  # fmt: skip


def list_yale_b(folder: Path | str) -> Listing:
    """All pictures with a known light.

    Raises:
        InputError: if the folder is missing or holds no such picture.
    """
    folder = need_folder(folder)
    parts = sorted(part for part in folder.iterdir() if part.is_dir() and _SUBJECT.fullmatch(part.name))
    if not parts and _SUBJECT.fullmatch(folder.name):
        parts = [folder]
    photos, skipped = [], []
    for part in parts:
        for path in sorted(part.iterdir()):
            name = path.relative_to(folder).as_posix()
            reason = _unusable(path)
            if reason is None:
                continue
            try:
                if reason:
                    raise InputError(reason)
                photos.append(_photo(name, path))
            except InputError as error:
                skipped.append(SkippedPhotos(name, str(error)))
    return Listing(NAME, folder, sort_photos(photos), tuple(skipped), linear=True)


def _unusable(path: Path) -> str | None:
    """Why a file is skipped, empty if it is a picture, None if it is not meant to be one."""
    if path.suffix in _ASIDE or "Ambient" in path.name or path.name.startswith("."):
        return None
    if path.suffix == ".bad":
        return "marked as bad by the database"
    if not _FILE.fullmatch(path.name):
        return "its name does not parse; yaleBNN_PNNA+AAAE+EE.pgm or .png is needed"
    return ""


def _photo(name: str, path: Path) -> FacePhoto:
    match = _FILE.fullmatch(path.name)
    assert match is not None
    subject, pose, azimuth, elevation, _ = match.groups()
    if path.parent.name != subject:
        raise InputError(f"a picture of {subject} in the folder of {path.parent.name}")
    eyes = read_eyes(side_file(path)) if side_file(path).is_file() else _crop_eyes(path)
    direction = heading(float(azimuth), float(elevation))
    light = f"A{azimuth}E{elevation}"
    return FacePhoto(name, path, subject, f"{subject}_{pose}", eyes, light, direction)


def _crop_eyes(path: Path) -> Eyes:
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(str(path))
    if source is None:
        oiio.geterror()
        raise InputError("broken, it cannot be decoded")
    spec = source.spec()
    source.close()
    if (spec.width, spec.height) != CROP_SIZE:
        raise InputError(
            f"{spec.width} x {spec.height} pixels; the crops of 168 x 192, or eye centres in a .toml beside "
            "it, are needed"
        )
    if spec.format.basesize() != 1:
        raise InputError(f"{8 * spec.format.basesize()} bits a sample, 8 are needed")
    return CROP_EYES
