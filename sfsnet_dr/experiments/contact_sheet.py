"""What rendered faces look like: a contact sheet as one picture and as a page, and one face relit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core import provenance
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import atomic_path, output_dir
from sfsnet_dr.core.image_io import write_png
from sfsnet_dr.core.visualize import Pixels, on_white, png_bytes, show_linear, show_normals
from sfsnet_dr.data.bundle import Bundle, read_bundle
from sfsnet_dr.data.manifest import NAME, Manifest
from sfsnet_dr.data.relight import relight_bundle
from sfsnet_dr.data.transforms.camera import PhotoOptions
from sfsnet_dr.inference.sheet import SheetStyle, draw_sheet
from sfsnet_dr.render.transport_shading import ResponseWeights, relight_responses
from sfsnet_dr.report.html import Block, Figure, Gallery, KeyNumbers, Section, write_page
from sfsnet_dr.report.plots import draw_histogram
from sfsnet_dr.report.record import Record, make_record
from sfsnet_dr.scene.lights.environment_map import load_environment
from sfsnet_dr.scene.lights.light import Light

Array = npt.NDArray[np.float64]

#: Names of skin tones by their individual typology angle (Chardonnet 1991), from its lower end in degrees.
TONES: Final = {
    "dark": -np.inf,
    "brown": -30.0,
    "tan": 10.0,
    "intermediate": 28.0,
    "light": 41.0,
    "very light": 55.0,
}

_ITA_BINS = tuple(range(-60, 81, 10))


@dataclass(frozen=True)
class _Shown:
    """One face as pictures."""

    seed: int
    reference: Pixels
    relit: Pixels
    normals: Pixels
    albedo: Pixels

    def cells(self) -> list[tuple[str, Pixels]]:
        return [
            (f"seed {self.seed}", self.reference),
            ("relit", self.relit),
            ("normals", self.normals),
            ("albedo", self.albedo),
        ]


def write_contact_sheet(
    folder: Path | str, out: Path | str, count: int = 24, *, command: str = ""
) -> list[Record]:
    """Write ``sheet.png`` and ``index.html`` about a dataset.

    Args:
        folder: a dataset.
        out: folder for the two files.
        count: faces on the sheet, taken evenly from all by seed. The histogram counts all faces.
        command: for the records.

    Returns:
        ``synth.faces``, and the extremes of the skin tones where the bundles say them.

    Raises:
        InputError: for a folder that holds no dataset, or a damaged bundle; nothing is written then.
    """
    folder = Path(folder)
    if count < 1:
        raise InputError(f"count: {count} found, at least 1 is needed")
    entries = sorted(Manifest(folder).entries, key=lambda entry: (entry.seed, entry.file))
    if not entries:
        raise InputError(f"{folder}: no bundles listed in {NAME}; render some with `sfsnet-dr synth`")
    places = np.unique(np.linspace(0, len(entries) - 1, min(count, len(entries))).round().astype(int))
    shown, tones, size = [], [], 0
    for place, entry in enumerate(entries):
        bundle = read_bundle(folder / entry.file)
        size = len(bundle.mask)
        if "ita" in bundle.meta.extra:
            tones.append(float(bundle.meta.extra["ita"]))
        if place in places:
            shown.append(_shown(bundle))
    records = [make_record("synth.faces", len(entries), "faces", command=command)]
    if tones:
        records.append(make_record("skin.ita.min", min(tones), "degrees", command=command))
        records.append(make_record("skin.ita.max", max(tones), "degrees", command=command))
    picture = _sheet(shown)
    target = output_dir(out)
    with atomic_path(target / "sheet.png") as partial:
        partial.write_bytes(picture)
    models = ", ".join(sorted({entry.face_model for entry in entries}))
    lead = f"{len(entries)} faces of the model `{models}`, {size} x {size} pixels; {len(shown)} are shown."
    footer = ", ".join(f"{name} {version}" for name, version in provenance.versions().items())
    write_page(target / "index.html", "Rendered faces", lead, _sections(shown, tones), footer=footer)
    return records


def relight_file(
    bundle: Path | str,
    out: Path | str,
    env: Path | str | None = None,
    direction: str | None = None,
    exposure: float = 0.8,
    photo_seed: int | None = None,
) -> None:
    """Write one face under another light as a PNG: bare, on black, or photographed.

    Args:
        bundle: file of a rendered face.
        out: the picture to write, ``.png``.
        env: environment map; its middle is where the viewer is.
        direction: three numbers ``"x,y,z"`` toward one white lamp, of any length. Either this or ``env``.
        exposure: mean shading of a white face.
        photo_seed: draws background, noise, blur, JPEG and so on; None takes no photograph.

    Raises:
        InputError: for anything that cannot be read or does not light the face.
    """
    if Path(out).suffix.lower() != ".png":
        raise InputError(f"{out}: suffix {Path(out).suffix!r} found, a picture is written as .png")
    if (env is None) == (direction is None):
        found = "neither" if env is None else "both"
        raise InputError(f"relight: {found} of --env and --direction found, one of them is needed")
    if not (np.isfinite(exposure) and exposure > 0):
        raise InputError(f"--exposure: {exposure} found, a number above 0 is needed")
    light = lamp_from_text(direction) if direction is not None else load_environment(Path(str(env)))
    if photo_seed is not None and photo_seed < 0:
        raise InputError(f"--photo-seed: {photo_seed} found, a number from 0 on is needed")
    photo = None if photo_seed is None else PhotoOptions()
    image = relight_bundle(read_bundle(bundle), light.exposed(exposure), photo, photo_seed or 0)
    write_png(out, np.clip(image, 0.0, None))


def lamp_from_text(text: str) -> Light:
    """A white lamp in a direction written as three numbers.

    Raises:
        InputError: for anything else, or the zero vector.
    """
    try:
        toward = np.array([float(part) for part in text.split(",")])
    except ValueError as error:
        raise InputError(f"--direction: {text!r} found, three numbers X,Y,Z are needed") from error
    length = float(np.linalg.norm(toward))
    if toward.shape != (3,) or not np.isfinite(length) or length == 0:
        raise InputError(f"--direction: {text!r} found, three finite numbers X,Y,Z are needed, not all 0")
    return Light("lamp", None, ((toward / length, np.ones(3)),))


def tone_name(ita: float) -> str:
    """Name of a skin tone by its ITA in degrees."""
    return [name for name, low in TONES.items() if ita > low][-1]


def _shown(bundle: Bundle) -> _Shown:
    light = bundle.meta.light.values
    same_light = relight_responses(
        bundle.transport[: len(light)],
        bundle.gloss,
        bundle.directional,
        ResponseWeights(light, np.zeros((len(bundle.directional), 3))),
    )
    pictures = (show_linear(bundle.reference), show_linear(same_light), show_normals(bundle.normal))
    faces = [on_white(picture, bundle.coverage) for picture in (*pictures, show_linear(bundle.albedo))]
    return _Shown(bundle.meta.seed, *faces)


def _sheet(shown: Sequence[_Shown]) -> bytes:
    cells = [cell for face in shown for cell in face.cells()]
    size = len(shown[0].reference)
    cell = size * max(1, 128 // size)
    return draw_sheet(cells, columns=12, style=SheetStyle(cell=cell, gap=8, margin=12, label=22))


def _sections(shown: Sequence[_Shown], tones: Sequence[float]) -> list[Section]:
    def gallery(name: str, caption: str) -> Gallery:
        pictures = [(png_bytes(getattr(face, name)), f"seed {face.seed}") for face in shown]
        return Gallery(pictures, caption)

    sections = [
        Section("Faces", [gallery("reference", "Path-traced, each face under a light of its own.")]),
        Section(
            "Relit", [gallery("relit", "The same light by the bundle's transport: no light was traced.")]
        ),
        Section("Normals", [gallery("normals", "Red to the right, green up, blue to the viewer.")]),
        Section("Albedo", [gallery("albedo", "Share of the light that the skin reflects.")]),
    ]
    return [*sections, Section("Skin tones", _tones(tones))] if tones else sections


def _tones(tones: Sequence[float]) -> list[Block]:
    names = [tone_name(ita) for ita in tones]
    numbers = [(f"{names.count(name)}", name) for name in TONES]
    plot = draw_histogram(tones, label="ITA of the skin, degrees", bins=_ITA_BINS, counted="faces")
    caption = "How often each skin tone occurs, by its individual typology angle: the lighter, the higher."
    return [KeyNumbers(numbers), Figure(plot, caption)]
