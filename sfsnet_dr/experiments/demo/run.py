"""``sfsnet-dr demo``: the whole pipeline in minutes, every stage real, and one page about it."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from sfsnet_dr.core.errors import InputError, RunError
from sfsnet_dr.core.files import output_dir
from sfsnet_dr.data.alignment import face_ellipse_mask, read_eyes, to_canonical
from sfsnet_dr.data.bundle import Bundle
from sfsnet_dr.data.generate import render_bundle, synthesize
from sfsnet_dr.experiments.demo.page import write_demo_page
from sfsnet_dr.experiments.demo.result import TOLERANCE, DemoResult
from sfsnet_dr.experiments.doctor import Report, check_installation
from sfsnet_dr.experiments.validation.records import study_records
from sfsnet_dr.experiments.validation.run import measure_scene
from sfsnet_dr.experiments.validation.summary import Study
from sfsnet_dr.inference.decompose import decompose_photographs, reconstruction_error
from sfsnet_dr.inference.outputs import Decomposition, write_decomposition
from sfsnet_dr.inference.photograph import Photograph
from sfsnet_dr.metrics.normals import NormalErrors, angular_error_deg
from sfsnet_dr.models.inference import load_model
from sfsnet_dr.models.shipped import BEST
from sfsnet_dr.report.console import progress_bar
from sfsnet_dr.report.record import Record, make_record, write_records
from sfsnet_dr.scene.lights.presets import light_set
from sfsnet_dr.scene.spec import SceneSpec, load_scene
from sfsnet_dr.scene.subject import build_subject
from sfsnet_dr.train.config import read_recipe
from sfsnet_dr.train.logging import read_history
from sfsnet_dr.train.run import TrainResult
from sfsnet_dr.train.trainer import train

FACES = 24
#: Far from the seeds of the training faces.
UNSEEN_SEED = 100_000
#: Lights of the validation in the demo; ``sfsnet-dr validate`` has more.
LIGHTS = "natural,directional60"
_COMMAND = "sfsnet-dr demo"
_BACKGROUND = 0.2


def run_demo(out: Path | str, root: Path | str = ".", *, console: Console | None = None) -> list[Record]:
    """Run every stage and write ``index.html`` and ``records.json``.

    Args:
        out: folder for everything; rendered faces and a finished training in it are used again.
        root: the checkout, for ``scenes/`` and ``training/``.
        console: where progress is shown; standard error by default.

    Raises:
        InputError: if ``root`` is no checkout, or ``out`` cannot be written to.
        RunError: if the renderer does not start.
    """
    begin = time.perf_counter()
    folder, checkout = output_dir(out), _checkout(root)
    screen = console or Console(stderr=True)
    doctor = _doctor(screen)
    spec = load_scene(checkout / "scenes" / "demo_faces.toml")
    rendered, render_seconds = _render(spec, folder / "faces", screen)
    studies = tuple(
        _validate(checkout / "scenes" / "validation" / f"{name}.toml", screen) for name in ("sphere", "head")
    )
    screen.rule("5/6  Train SfSNet for minutes", align="left")
    training = train(
        read_recipe(checkout / "training" / "recipes" / "smoke.toml"),
        folder / "faces",
        folder / "training",
        resume=(folder / "training").exists(),
    )
    screen.rule("6/6  Decompose a photograph and an unseen face", align="left")
    truth = render_bundle(spec, UNSEEN_SEED)
    photograph, synthetic = _decompose([astronaut(), _unseen(truth)], BEST)
    for face in (photograph, synthetic):
        write_decomposition(folder, face, {})
    [own] = _decompose([_unseen(truth)], training.weights)
    errors, own_errors = (angular_error_deg(f.normal, truth.normal, truth.mask) for f in (synthetic, own))
    records = _records(studies, training, photograph, synthetic, errors)
    records.append(
        make_record(
            "demo.own.normals.mean_deg", own_errors.mean, "degrees", command=_COMMAND, seed=UNSEEN_SEED
        )
    )
    records.append(make_record("import.seconds", import_seconds(), "s", command=_COMMAND))
    records.append(make_record("demo.seconds", time.perf_counter() - begin, "s", command=_COMMAND))
    result = DemoResult(
        doctor=doctor,
        spec=spec,
        bundles=_first_bundles(folder / "faces"),
        rendered=rendered,
        render_seconds=render_seconds,
        studies=studies,
        training=training,
        history=read_history(training.history),
        photograph=photograph,
        synthetic=synthetic,
        truth=truth,
        normal_errors=errors,
        own_errors=own_errors,
        records=tuple(records),
    )
    write_records(folder / "records.json", records)
    write_demo_page(folder / "index.html", result)
    return records


def import_seconds() -> float:
    """Least of five times that ``import sfsnet_dr`` takes in a fresh interpreter."""
    code = "import time; t = time.perf_counter(); import sfsnet_dr; print(time.perf_counter() - t)"

    def once() -> float:
        run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        return float(run.stdout)

    return min(once() for _ in range(5))


def astronaut() -> Photograph:
    """scikit-image's bundled portrait (NASA, public domain) in the canonical frame, linear."""
    from skimage.data import astronaut as load

    from sfsnet_dr.core.color import srgb_to_linear

    eyes = read_eyes(Path(__file__).with_name("astronaut.toml"))
    encoded: NDArray[np.uint8] = load()  # type: ignore[no-untyped-call]
    linear = srgb_to_linear(encoded / 255.0)
    return Photograph("astronaut", to_canonical(linear, eyes), face_ellipse_mask())


def _checkout(root: Path | str) -> Path:
    folder = Path(root)
    for part in (
        "scenes/demo_faces.toml",
        "scenes/validation/sphere.toml",
        "scenes/validation/head.toml",
        "training/recipes/smoke.toml",
    ):
        if not (folder / part).is_file():
            raise InputError(f"{folder / part}: no such file; run the demo in a checkout of sfsnet_dr")
    return folder


def _doctor(screen: Console) -> Report:
    screen.rule("1/6  Does the renderer start?", align="left")
    report = check_installation()
    screen.print(report.to_text(), highlight=False, markup=False)
    if not report.ok:
        failed = next(check for check in report.checks if not check.ok)
        raise RunError(f"doctor: {failed.name}: {failed.detail}")
    return report


def _render(spec: SceneSpec, folder: Path, screen: Console) -> tuple[int, float]:
    screen.rule(f"2/6  Render {FACES} faces with their light transport", align="left")
    begin, rendered = time.perf_counter(), 0
    with progress_bar("faces", FACES) as advance:

        def on_face(seed: int) -> None:
            nonlocal rendered
            rendered += 1
            advance()

        synthesize(folder, spec, FACES, resume=True, on_face=on_face)
    return rendered, time.perf_counter() - begin


def _validate(path: Path, screen: Console) -> Study:
    spec = load_scene(path)
    number = 3 if spec.shape == "sphere" else 4
    screen.rule(f"{number}/6  Measure SH shading against the path tracer: {spec.name}", align="left")
    return measure_scene(build_subject(spec), light_set(LIGHTS), cold=False)


def _unseen(truth: Bundle) -> Photograph:
    background = _BACKGROUND * (1.0 - truth.coverage[..., None])
    return Photograph("unseen-face", (truth.reference + background).astype(np.float32), truth.mask)


def _decompose(photographs: Sequence[Photograph], weights: Path | str) -> list[Decomposition]:
    return decompose_photographs(load_model(weights), photographs)


def _records(
    studies: tuple[Study, ...],
    training: TrainResult,
    photograph: Decomposition,
    synthetic: Decomposition,
    errors: NormalErrors,
) -> list[Record]:
    records = [r for study in studies for r in study_records(study, TOLERANCE, _COMMAND, 0) if _brief(r)]
    losses = {"first": training.first, "final": training.final}
    for when, terms in losses.items():
        for term, value in terms.items():
            records.append(make_record(f"demo.train.{when}.{term}", value, "1", command=_COMMAND, seed=0))
    for face in (photograph, synthetic):
        name = f"demo.{face.name.replace('-', '_')}.reconstruction.mae_8bit"
        records.append(make_record(name, reconstruction_error(face), "8-bit sRGB", command=_COMMAND, seed=0))
    normals = "demo.unseen_face.normals.mean_deg"
    records.append(make_record(normals, errors.mean, "degrees", command=_COMMAND, seed=UNSEEN_SEED))
    return records


def _brief(record: Record) -> bool:
    """Errors and times only: what the errors are made of stands in the records of ``validate``."""
    return record.what.endswith((".rel_rmse", ".seconds"))


def _first_bundles(folder: Path) -> tuple[Bundle, ...]:
    from sfsnet_dr.data.bundle import read_bundle

    return tuple(read_bundle(path) for path in sorted(folder.glob("face-*.exr"))[:FACES])
