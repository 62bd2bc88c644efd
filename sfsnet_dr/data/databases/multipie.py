"""CMU MultiPIE: faces under 18 flashes and none, nested by session, recording, subject, expression, camera.

Folder: ``sessionSS/multiview/SUB/REC/CC_C/SUB_SS_REC_CCC_LL.png`` (or .jpg) at any depth, with subject,
session, recording (expression), camera and light in the name. The frontal camera is 05_1. The lights 00 to 18
are the paper's 19 classes: 00 has no flash, 19 is a second picture without one and left out. Where the
68 landmarks of a picture are must be told by ``landmarks.npz`` at the top: ``files`` (N paths below it) and
``points`` (N, 68, 2) in pixels; the database has none. The directions of its lights are not known here.
Source: Gross et al., Multi-PIE, 2010.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.alignment import eye_centres
from sfsnet_dr.data.databases.base import FacePhoto, Listing, need_folder, sort_photos
from sfsnet_dr.data.photos import SkippedPhotos, read_landmarks

NAME: Final = "multipie"
FRONTAL: Final = "051"
LIGHTS_19: Final = tuple(f"{number:02d}" for number in range(19))

_FILE: Final = re.compile(r"(\d{3})_(\d{2})_(\d{2})_(\d{3})_(\d{2})\.(png|jpg)")


def list_multipie(folder: Path | str, camera: str = FRONTAL) -> Listing:
    """The pictures of one camera.

    Args:
        folder: that of the database.
        camera: three digits, as in the names of files.

    Raises:
        InputError: if the folder or its landmarks are missing, or none of the pictures has any.
    """
    folder = need_folder(folder)
    known = read_landmarks(folder / "landmarks.npz")
    photos, skipped = [], []
    for path in sorted(p for p in folder.rglob("*") if p.suffix in (".png", ".jpg")):
        name = path.relative_to(folder).as_posix()
        match = _FILE.fullmatch(path.name)
        if match and (match[4] != camera or match[5] not in LIGHTS_19):
            continue
        try:
            if not match:
                raise InputError("its name does not parse; SUB_SS_REC_CAM_LL.png is needed")
            subject, session, recording, _, light = match.groups()[:5]
            if name not in known:
                raise InputError("its name is not among the landmarks")
            photos.append(
                FacePhoto(
                    name, path, subject, f"{subject}_{session}_{recording}", eye_centres(known[name]), light,
                    points=known[name],
                )
            )  # fmt: skip
        except InputError as error:
            skipped.append(SkippedPhotos(name, str(error)))
    return Listing(NAME, folder, sort_photos(photos), tuple(skipped))
