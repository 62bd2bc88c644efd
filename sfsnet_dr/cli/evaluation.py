"""Commands about databases of real faces and their ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from sfsnet_dr.cli.common import Json, Out, Result, command_line, result_of_records
from sfsnet_dr.core.errors import InputError

if TYPE_CHECKING:
    from sfsnet_dr.report.record import Record

Database = Literal["yale-b", "photoface", "multipie", "celeba", "folder"]
Baseline = Literal["flat", "mean-face", "one-albedo", "mean-albedo", "3dmm", "sirfs"]
DatabaseFolder = Positional[
    Annotated[Path, arg(metavar="DIR", help="Its folder; the head of data/NAME.py says what is in it.")]
]

#: Lines of skipped files that are shown; all are counted.
_SHOWN = 20


@dataclass(frozen=True)
class DataCheck:
    """See whether a folder holds a face database as its reader expects it, and count what is in it.

    Files that cannot be used are named with the reason. Of the photographs --decode are read and brought to
    the canonical frame, spread evenly over all.

    Example: sfsnet-dr data check yale-b CroppedYale
    """

    database: Positional[Annotated[Database, arg(metavar="NAME", help="Which database it is.")]]
    folder: DatabaseFolder
    decode: Annotated[int, arg(help="Photographs to decode; 0 for none.")] = 200
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.data.databases.registry import check_database
        from sfsnet_dr.report.console import progress_bar
        from sfsnet_dr.report.record import dotted_word, make_record

        with progress_bar("reading photographs", self.decode) as advance:
            found = check_database(self.database, self.folder, self.decode, advance)
        records = [
            make_record(f"data.{dotted_word(self.database)}.{name}", count, "1", command=command_line())
            for name, count in found.counts.items()
        ]
        lines = [f"skipped: {item.name}: {item.reason}" for item in found.skipped[:_SHOWN]]
        lines += [f"fewer than four usable lights: {name}" for name in found.few_lights[:_SHOWN]]
        return result_of_records(records, *lines)


@dataclass(frozen=True)
class PhotometricStereo:
    """Compute normals and albedo of faces from photographs under several lights, as labels.

    DIR is a folder of Extended Yale B or Photoface. Every image set (one face, one pose) with four lights or
    more is solved by a robust fit per pixel; light intensities are estimated from all image sets. With
    --calibrate-with the known light directions are not read: they are calibrated from the images and a
    network's normals, which needs a dozen lights. Writes OUT/normal_labels.json, one .safetensors per image
    set, and OUT/sheet.png.

    Example: sfsnet-dr photometric-stereo CroppedYale --out out/yale-b
    """

    folder: DatabaseFolder
    out: Out
    database: Annotated[Literal["yale-b", "photoface"], arg(help="Which database it is.")] = "yale-b"
    calibrate_with: Annotated[
        str | None,
        arg(
            metavar="WEIGHTS",
            help="Calibrate the lights from the images with this network, in place of the known directions.",
        ),
    ] = None
    prior_faces: Annotated[
        tuple[Path, ...],
        arg(
            metavar="DIR...",
            help="With --calibrate-with: folders of `sfsnet-dr synth`. The mean orientation and slope of "
            "their heads resolve the bas-relief ambiguity. Default: the network's normals alone do.",
        ),
    ] = ()
    check_faces: Annotated[
        int, arg(help="Rendered faces with known normals to check the method on first; 2 s each.")
    ] = 0
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.data.databases.registry import open_database
        from sfsnet_dr.experiments.photometric_stereo.captures import read_image_sets
        from sfsnet_dr.experiments.photometric_stereo.run import (
            compute_normal_labels,
            label_records,
            light_records,
        )
        from sfsnet_dr.experiments.photometric_stereo.uncalibrated import (
            calibrate_image_sets,
            light_direction_errors,
        )
        from sfsnet_dr.report.console import progress_bar
        from sfsnet_dr.report.record import write_records

        if self.prior_faces and self.calibrate_with is None:
            raise InputError(
                "--prior-faces: found without --calibrate-with; known light directions need no prior"
            )
        known = open_database(self.database, self.folder)
        with progress_bar("reading photographs", len(known.captures())) as advance:
            read = read_image_sets(known, advance)
        if self.calibrate_with is not None:
            with progress_bar("calibrating lights", len(read.faces)) as advance:
                read = calibrate_image_sets(read, self.calibrate_with, self.prior_faces, advance)
        with progress_bar("photometric stereo", len(read.faces)) as advance:
            found = compute_normal_labels(read, self.out, on_capture=advance)
        records = label_records(known, found, command_line()) + self._checked()
        if self.calibrate_with is not None:
            errors = light_direction_errors(known, read.listing)
            records += light_records(read.listing, errors, command_line())
        write_records(self.out / "records.json", records)
        lines = [f"skipped: {name}: {reason}" for name, reason in list(found.skipped.items())[:_SHOWN]]
        return result_of_records(records, *lines, f"labels: {self.out}")

    def _checked(self) -> list[Record]:
        if not self.check_faces:
            return []
        from sfsnet_dr.experiments.photometric_stereo.check import check_on_rendered_faces
        from sfsnet_dr.experiments.photometric_stereo.run import check_records
        from sfsnet_dr.report.console import progress_bar

        with progress_bar("checking on rendered faces", self.check_faces) as advance:
            errors = check_on_rendered_faces(range(self.check_faces), on_face=advance)
        return check_records(errors, command_line())


@dataclass(frozen=True)
class Evaluate:
    """Measure networks and baselines on faces: normals, albedo, reconstruction, light, and their speed.

    DATA is yale-b or photoface (the truth is made by photometric stereo), labels (what `sfsnet-dr
    photometric-stereo` wrote), lights (classification of a database's lights alone), celeba, synthetic
    (folders of `sfsnet-dr synth`; the bundles that training holds back), or all: whatever of these DIR or its
    folders hold. Without such a word, it is a folder of photographs with landmarks. OUT gets records.json,
    table.csv and index.html, a page that shows the people: mind the terms of the data.

    Example: sfsnet-dr evaluate yale-b CroppedYale --weights out/sfsnet/weights.safetensors --out out/yale-b
    """

    data: Positional[Annotated[tuple[str, ...], arg(metavar="DATA DIR", help="What to measure on.")]]
    out: Out
    weights: Annotated[
        tuple[Path, ...], arg(metavar="FILE", help="Weights of networks to measure beside the baselines.")
    ] = ()
    methods: Annotated[
        tuple[Baseline, ...], arg(metavar="NAME", help="Baselines; left out, all that can run.")
    ] = ()
    landmarks: Annotated[
        Path | None,
        arg(metavar="FILE", help="For 3dmm: .npz with files and points (N, 68, 2); else looked for in DIR."),
    ] = None
    model_path: Annotated[
        Path | None,
        arg(metavar="PATH", help="For 3dmm: ICT FaceKit, as `sfsnet-dr fit-light-prior` takes it."),
    ] = None
    faces: Annotated[
        tuple[Path, ...], arg(metavar="DIR", help="For all: folders of rendered faces that lie elsewhere.")
    ] = ()
    max_images: Annotated[
        int, arg(help="Measure at most this many images of celeba, a folder or synthetic.")
    ] = 300
    database: Annotated[
        Literal["yale-b", "photoface", "multipie"], arg(help="Whose lights `lights` are.")
    ] = "yale-b"
    no_tta: Annotated[
        bool, arg(help="No test-time augmentation (mirror images): half the time, less exact.")
    ] = False
    quick: Annotated[bool, arg(help="Four subjects, half of the lights, 60 photographs.")] = False
    as_json: Json = False

    def run(self) -> Result:
        from sfsnet_dr.core.errors import InputError
        from sfsnet_dr.experiments.evaluation.collect import KINDS, Amount, collect_samples
        from sfsnet_dr.experiments.evaluation.methods import RequestedMethod, methods_for
        from sfsnet_dr.experiments.evaluation.run import evaluate, evaluate_all

        kind, *rest = self.data or ("",)
        folders = [Path(folder) for folder in rest]
        if not rest and Path(kind).is_dir() and kind not in (*KINDS, "all"):
            kind, folders = "folder", [Path(kind)]
        amount = Amount(self.max_images, self.quick, self.database)
        wanted = RequestedMethod(self.methods, self.weights, self.landmarks, self.model_path, self.no_tta)
        if kind == "all":
            if len(folders) != 1:
                raise InputError(f"all: {len(folders)} folders found, one is needed")
            records, left_out = evaluate_all(folders[0], self.faces, wanted, self.out, amount, command_line())
        else:
            if self.faces:
                raise InputError(f"--faces: is for `all`; give the folders after {kind}")
            collection = collect_samples(kind, folders, amount)
            methods, left_out = methods_for(collection.shots, wanted, collection.listing)
            records = evaluate(collection, methods, self.out, command_line())
        lines = [f"left out: {name}: {reason}" for name, reason in left_out.items()]
        return result_of_records(records, *lines, f"page: {self.out / 'index.html'}")
