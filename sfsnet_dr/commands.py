"""The commands of ``sfsnet-dr``: each a dataclass of its arguments that calls the library.

Heavy imports stand inside ``run``, so that help and wrong arguments answer at once.
"""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

from tyro.conf import Positional, arg

if TYPE_CHECKING:
    from sfsnet_dr.report.record import Record
    from sfsnet_dr.scene.spec import SceneSpec

Json = Annotated[
    bool, arg(name="json", help="Print a JSON array of records on standard output, nothing else.")
]
Out = Annotated[Path, arg(metavar="DIR", help="Folder for the results; made if it is missing.")]


@dataclass(frozen=True)
class Result:
    """What a command has to say: lines to read, JSON for machines, and its exit code."""

    text: str
    json: str
    code: int = 0


@dataclass(frozen=True)
class Doctor:
    """Compile a kernel and render a tiny scene in a process of its own, and report what was found.

    Ends with exit code 1 if anything fails, an abort of the process included.

    Example: sfsnet-dr doctor
    """

    as_json: Annotated[bool, arg(name="json", help="Print the report as JSON, nothing else.")] = False

    def run(self) -> Result:
        from sfsnet_dr.study.doctor import diagnose

        report = diagnose()
        return Result(text=report.to_text(), json=report.to_json(), code=0 if report.ok else 1)


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
        from sfsnet_dr.report.record import measured

        begin, rendered = time.perf_counter(), _render_faces(self.spec(), self)
        seconds = time.perf_counter() - begin
        records = [measured("synth.faces", rendered, "faces", command=command_line(), seed=self.seed)]
        if rendered:
            each = measured("synth.seconds_per_face", seconds / rendered, "s", command=command_line())
            records.append(each)
        return _of_records(records, f"written: {self.out}")

    def spec(self) -> SceneSpec:
        """The scene with the options in place of what it says."""
        from sfsnet_dr.scene.spec import SceneSpec, load_scene

        spec = SceneSpec("faces", "anny") if self.scene is None else load_scene(self.scene)
        if self.face_model is not None:
            kept = spec.model_path if self.face_model == spec.shape else None
            spec = replace(spec, shape=self.face_model, model_path=kept)
        return spec if self.model_path is None else replace(spec, model_path=str(self.model_path))


@dataclass(frozen=True)
class Show:
    """A contact sheet of rendered faces: sheet.png and a page, index.html, with the spread of skin tones.

    Example: sfsnet-dr show out/faces --out out/sheet
    """

    data: Positional[Annotated[Path, arg(metavar="DIR", help="Folder that `sfsnet-dr synth` wrote.")]]
    out: Out
    count: Annotated[int, arg(help="Faces on the sheet, evenly out of all.")] = 24
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.study.contact_sheet import show

        records = show(self.data, self.out, self.count, command=command_line())
        return _of_records(records, f"page: {self.out / 'index.html'}", f"sheet: {self.out / 'sheet.png'}")


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
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.study.contact_sheet import relight_file

        relight_file(self.bundle, self.out, self.env, self.direction, self.exposure)
        return _of_records([], f"written: {self.out}")


@dataclass(frozen=True)
class Train:
    """Train a network by a recipe, on faces relit on the fly.

    Without --data the faces are rendered first, into OUT/faces. A stopped run goes on with --resume and ends
    with the same weights as one that was never stopped.

    Example: sfsnet-dr train training/recipes/smoke.toml --out out/smoke
    """

    recipe: Positional[
        Annotated[Path, arg(metavar="RECIPE", help="Recipe (TOML); its head says what it costs.")]
    ]
    out: Out
    data: Annotated[Path | None, arg(metavar="DIR", help="Folder that `sfsnet-dr synth` wrote.")] = None
    faces: Annotated[int, arg(help="Faces to render where --data is not given.")] = 24
    resume: Annotated[bool, arg(help="Go on from the last checkpoint in --out.")] = False
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.fit.recipe import read_recipe
        from sfsnet_dr.fit.trainer import train
        from sfsnet_dr.report.record import dotted, measured
        from sfsnet_dr.scene.spec import SceneSpec

        recipe = read_recipe(self.recipe)
        data = self.data or self.out / "faces"
        if self.data is None:
            _render_faces(SceneSpec("faces", "anny"), Synth(data, self.faces, resume=True))
        result = train(recipe, data, self.out, resume=self.resume, progress=True)
        records = [
            measured(f"train.loss.{dotted(term)}", value, "1", command=command_line(), seed=recipe.seed)
            for term, value in result.final.items()
        ]
        return _of_records(records, f"weights: {result.weights}")


@dataclass(frozen=True)
class Decompose:
    """Take photographs of faces apart: normals, albedo, shading, reconstruction and three relit views.

    Writes OUT/NAME for each NAME.png: eight pictures, a sheet of them, and decomposition.exr to compute with.
    A picture must be 128 x 128 in the canonical frame (eye centres at (45, 48) and (83, 48), x right, y
    down), or its eye centres must be given: by --eyes, or in NAME.toml beside it with the two lines
    eye_image_left = [x, y] and eye_image_right = [x, y].

    Example: sfsnet-dr decompose me.jpg --eyes 201,190,255,188 --weights w.safetensors --out out/me
    """

    images: Positional[
        Annotated[
            tuple[Path, ...],
            arg(
                metavar="IMAGE",
                help_behavior_hint="(required, several allowed)",
                help="PNG, JPEG, EXR or HDR.",
            ),
        ]
    ]
    weights: Annotated[Path, arg(metavar="FILE", help="Weights that `sfsnet-dr train` wrote (.safetensors).")]
    out: Out
    eyes: Annotated[
        str | None,
        arg(
            metavar="XL,YL,XR,YR",
            help="Eye centres in pixels, the one on the image's left first; holds for every image.",
        ),
    ] = None
    mask: Annotated[Path | None, arg(metavar="FILE", help="Picture of its size, white on the face.")] = None
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.apply.decompose import decompose, reconstruction_error
        from sfsnet_dr.apply.picture import eyes_from_text
        from sfsnet_dr.report.record import dotted, measured

        eyes = None if self.eyes is None else eyes_from_text("--eyes", self.eyes)
        faces = decompose(self.images, self.out, self.weights, eyes=eyes, mask=self.mask)
        records = [
            measured(
                f"decompose.{dotted(face.name)}.reconstruction.mae_8bit",
                reconstruction_error(face),
                "8-bit sRGB",
                command=command_line(),
            )
            for face in faces
        ]
        return _of_records(records, *(f"written: {self.out / face.name}" for face in faces))


@dataclass(frozen=True)
class Validate:
    """Measure the order-2 spherical-harmonic renderer against the path tracer: error and time of a scene.

    Example: sfsnet-dr validate scenes/sphere.toml --out out/validate
    """

    scene: Positional[Annotated[Path, arg(metavar="SCENE", help="Scene (TOML) of the folder scenes/.")]]
    out: Out
    tolerance: Annotated[
        float | None,
        arg(metavar="RATIO", help="Relative RMS error of order 2 above which the exit code is 1."),
    ] = None
    seed: Annotated[int, arg(help="Seed of the head and of the path tracer's noise.")] = 0
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.study.validate import validate

        records = validate(self.scene, self.out, self.tolerance, seed=self.seed, command=command_line())
        return _of_records(records, f"report: {self.out / 'index.html'}")


@dataclass(frozen=True)
class Demo:
    """The whole pipeline, in minutes: check, render, measure, train, decompose, and one HTML report.

    Example: sfsnet-dr demo --out out/demo
    """

    out: Out = Path("out/demo")
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.study.demo import run_demo

        return _of_records(run_demo(self.out), f"report: {self.out / 'index.html'}")


Command = Doctor | Synth | Show | Relight | Train | Decompose | Validate | Demo

#: Commands by the name on the command line, with the line that the overview shows.
COMMANDS: Final[dict[str, tuple[type[Command], str]]] = {
    "doctor": (Doctor, "Check that this machine can render"),
    "synth": (Synth, "Render faces with their ground truth"),
    "show": (Show, "Make a contact sheet of rendered faces"),
    "relight": (Relight, "Put one rendered face under another light"),
    "train": (Train, "Train a network by a recipe"),
    "decompose": (Decompose, "Take photographs of faces apart"),
    "validate": (Validate, "Measure the SH renderer against the path tracer"),
    "demo": (Demo, "Run the whole pipeline and write a report"),
}


def command_line() -> str:
    """The command as typed, for records."""
    return shlex.join(["sfsnet-dr", *sys.argv[1:]])


def _render_faces(scene: SceneSpec, wanted: Synth) -> int:
    """Render what ``wanted`` asks for under a progress bar; the number of faces rendered now."""
    from sfsnet_dr.data.synth import synthesize
    from sfsnet_dr.report.console import bar

    rendered = []
    with bar("rendering faces", wanted.count) as advance:

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


def _of_records(records: Sequence[Record], *more: str) -> Result:
    """Records as JSON, or as lines to read with more lines after them."""
    from sfsnet_dr.report.console import lines
    from sfsnet_dr.report.record import to_json

    return Result(text="\n".join([*lines(records), *more]), json=to_json(records))
