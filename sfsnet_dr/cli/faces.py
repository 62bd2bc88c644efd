"""Commands that make rendered faces and look at them."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from sfsnet_dr.cli.common import Json, Out, Result, command_line, result_of_records

if TYPE_CHECKING:
    from sfsnet_dr.scene.spec import SceneSpec


@dataclass(frozen=True)
class Synth:
    """Render faces: normals, albedo, mask, path-traced reference and light transport, one EXR a face.

    The same seed gives the same files, however many workers run and wherever they do. A stopped run goes on
    with --resume.

    Example: sfsnet-dr synth --out out/faces --count 24 --face-model anny
    """

    out: Out
    count: Annotated[int, arg(help="Faces to render.")] = 24
    face_model: Annotated[
        Literal["anny", "ict", "basel"] | None,
        arg(help="Where heads come from, in place of the scene's. anny needs no files."),
    ] = None
    model_path: Annotated[
        Path | None,
        arg(metavar="PATH", help="The face model: ict's .npz or FaceXModel folder, basel's .h5."),
    ] = None
    scene: Annotated[
        Path | None, arg(metavar="FILE", help="Scene (TOML); left out, that of scenes/faces.toml.")
    ] = None
    seed: Annotated[int, arg(help="Seed of the first face; the next ones follow.")] = 0
    workers: Annotated[int, arg(help="Processes that render side by side.")] = 1
    resume: Annotated[bool, arg(help="Keep the faces that are there and render the missing ones.")] = False
    ray: Annotated[
        str | None,
        arg(metavar="ADDRESS", help="Render on Ray: local, or HOST:PORT of a running cluster."),
    ] = None
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.report.record import make_record

        begin, rendered = time.perf_counter(), render_faces(self.spec(), self)
        seconds = time.perf_counter() - begin
        records = [make_record("synth.faces", rendered, "faces", command=command_line(), seed=self.seed)]
        if rendered:
            each = make_record("synth.seconds_per_face", seconds / rendered, "s", command=command_line())
            records.append(each)
        return result_of_records(records, f"written: {self.out}")

    def spec(self) -> SceneSpec:
        """The scene with the options in place of what it says."""
        from sfsnet_dr.scene.spec import SceneSpec, load_scene

        spec = SceneSpec("faces", "anny") if self.scene is None else load_scene(self.scene)
        if self.face_model is not None:
            kept = spec.model_path if self.face_model == spec.shape else None
            spec = replace(spec, shape=self.face_model, model_path=kept)
        return spec if self.model_path is None else replace(spec, model_path=str(self.model_path))


@dataclass(frozen=True)
class ContactSheet:
    """A contact sheet of rendered faces: sheet.png and a page, index.html, with the spread of skin tones.

    Example: sfsnet-dr contact-sheet out/faces --out out/sheet
    """

    data: Positional[Annotated[Path, arg(metavar="DIR", help="Folder that `sfsnet-dr synth` wrote.")]]
    out: Out
    count: Annotated[int, arg(help="Faces on the sheet, evenly out of all.")] = 24
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.experiments.contact_sheet import write_contact_sheet

        records = write_contact_sheet(self.data, self.out, self.count, command=command_line())
        return result_of_records(
            records, f"page: {self.out / 'index.html'}", f"sheet: {self.out / 'sheet.png'}"
        )


@dataclass(frozen=True)
class Relight:
    """One rendered face under another light, as a PNG.

    Example: sfsnet-dr relight out/faces/face-000003.exr --direction=-1,0.3,0.6 --out out/relit.png
    """

    bundle: Positional[Annotated[Path, arg(metavar="BUNDLE", help="EXR that `sfsnet-dr synth` wrote.")]]
    out: Annotated[Path, arg(metavar="FILE", help="Picture to write (.png).")]
    env: Annotated[
        Path | None, arg(metavar="MAP", help="Environment map (.exr, .hdr), twice as wide as high.")
    ] = None
    direction: Annotated[
        str | None,
        arg(metavar="X,Y,Z", help="Toward one white lamp: x to the image's right, y up, z to the viewer."),
    ] = None
    exposure: Annotated[float, arg(help="Mean shading of a white face, 1 being the picture's white.")] = 0.8
    photo_seed: Annotated[
        int | None,
        arg(
            metavar="N", help="Photograph it: background, noise, blur, JPEG and so on, drawn from this seed."
        ),
    ] = None
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.experiments.contact_sheet import relight_file

        relight_file(self.bundle, self.out, self.env, self.direction, self.exposure, self.photo_seed)
        return result_of_records([], f"written: {self.out}")


def render_faces(scene: SceneSpec, wanted: Synth) -> int:
    """Render what ``wanted`` asks for under a progress bar; the number of faces rendered now."""
    from sfsnet_dr.data.generate import synthesize
    from sfsnet_dr.report.console import progress_bar

    rendered = []
    with progress_bar("rendering faces", wanted.count) as advance:

        def on_face(seed: int) -> None:
            rendered.append(seed)
            advance()

        synthesize(
            wanted.out,
            scene,
            wanted.count,
            seed=wanted.seed,
            workers=wanted.workers,
            resume=wanted.resume,
            ray=wanted.ray,
            on_face=on_face,
        )
    return len(rendered)
