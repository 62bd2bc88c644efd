"""``sfsnet-dr train-all RELEASE.toml``: a released network, from rendered faces to weights and card."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from rich.console import Console

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import output_dir, write_text
from sfsnet_dr.core.provenance import sha256
from sfsnet_dr.data.databases.registry import open_database
from sfsnet_dr.data.manifest import Manifest
from sfsnet_dr.data.normal_labels import INDEX
from sfsnet_dr.data.photos import photo_folder
from sfsnet_dr.data.pseudo_labels import MANIFEST
from sfsnet_dr.experiments.photometric_stereo.captures import read_image_sets
from sfsnet_dr.experiments.photometric_stereo.run import compute_normal_labels
from sfsnet_dr.experiments.photometric_stereo.uncalibrated import calibrate_image_sets
from sfsnet_dr.experiments.pipeline.cache import label_photographs, render_missing, train_once
from sfsnet_dr.experiments.pipeline.model_card import measure_shipped
from sfsnet_dr.experiments.pipeline.release_config import Release, StageSpec
from sfsnet_dr.models.shipped import HELDOUT, SHIPPED, weights_path
from sfsnet_dr.models.weights import load_weights, read_metadata, save_weights
from sfsnet_dr.report.console import progress_bar
from sfsnet_dr.report.record import Record, write_records
from sfsnet_dr.train.averaging import average_weights
from sfsnet_dr.train.run import WEIGHTS

#: Photographs that get no pseudo-labels, for validation.
NUM_VAL = 500


@dataclass(frozen=True)
class Inputs:
    """What a release needs from outside.

    Attributes:
        database: folder of Extended Yale B, for normal labels.
        photographs: folder of photographs with landmarks, for pseudo-labels.
        model_path: ICT FaceKit, for its faces.
    """

    database: Path | None = None
    photographs: Path | None = None
    model_path: Path | None = None


@dataclass(frozen=True)
class PlanLine:
    """One line of the plan: what it is, whether it is done, its cost, and what is missing for it."""

    name: str
    what: str
    done: bool
    minutes: float
    missing: str = ""


def plan_release(release: Release, out: Path | str, inputs: Inputs) -> list[PlanLine]:
    """Return what a run would do: each set of faces and each stage, with what is missing, and the cost."""
    folder, lines = Path(out), []
    for name, (faces, _) in release.faces.items():
        there = _rendered(folder / "faces" / name)
        needs = faces.face_model == "ict" and inputs.model_path is None
        missing = "--model-path (ICT FaceKit)" if needs and there < faces.count else ""
        what = f"render {faces.count} faces ({there} there)"
        lines.append(PlanLine(name, what, there >= faces.count, faces.minutes, missing))
    for stage in release.spec.stage:
        done = _result(folder, stage).is_file()
        lines.append(
            PlanLine(
                stage.name,
                _describe(release, stage),
                done,
                stage.minutes,
                "" if done else _missing(folder, stage, inputs),
            )
        )
    return lines


def plan_text(lines: list[PlanLine]) -> str:
    """Return the plan as a table, with what is missing and the total cost."""
    width = max(len(line.name) for line in lines)
    rows = [
        f"  {line.name:<{width}}  {'done' if line.done else f'{line.minutes:.0f} min':>8}  {line.what}"
        + (f"; missing: {line.missing}" if line.missing else "")
        for line in lines
    ]
    left = sum(line.minutes for line in lines if not line.done)
    return "\n".join(
        [*rows, f"  {'left':<{width}}  {left:.0f} min  on 2 cores, as measured when the weights were made"]
    )


def run_release(
    release: Release, out: Path | str, inputs: Inputs, *, command: str, console: Console | None = None
) -> list[Record]:
    """Run what is not done yet, and write ``NAME.safetensors``, ``NAME.json`` and ``NAME.md``.

    Every stage keeps its result under its name in ``out``; the same call continues a stopped run, within a
    training stage too, and ends with the same weights.

    Args:
        release: of ``read_release``.
        out: folder for everything.
        inputs: data from outside.
        command: for the records.
        console: where progress is shown; standard error by default.

    Returns:
        Numbers of the released network on rendered faces, and on photographs where given.

    Raises:
        InputError: before anything is done, if an input is missing; for unusable data.
        RunError: if training failed or was told to stop; the same call continues.
    """
    screen, plan = console or Console(stderr=True), plan_release(release, out, inputs)
    screen.print(plan_text(plan), highlight=False, markup=False)
    missing = [f"{line.name} needs {line.missing}" for line in plan if line.missing]
    if missing:
        raise InputError(f"{release.spec.name}: {'; '.join(missing)}")
    folder = output_dir(out)

    def rule(name: str, state: str) -> None:
        screen.rule(f"{name}: {state}", align="left")

    for name, (faces, scene) in release.faces.items():
        spec = replace(scene, shape=faces.face_model)
        if faces.face_model == "ict":
            spec = replace(spec, model_path=str(inputs.model_path))
        render_missing(folder / "faces" / name, spec, faces.count, partial(rule, name), seed=faces.seed)
    for stage in release.spec.stage:
        _run_stage(release, stage, folder, inputs, partial(rule, stage.name))
    return _finish(release, folder, inputs, command)


def _run_stage(
    release: Release, stage: StageSpec, folder: Path, inputs: Inputs, tell: Callable[[str], None]
) -> None:
    if stage.kind == "train":
        init = release.init[stage.name]
        train_once(
            release.recipes[stage.name],
            [folder / "faces" / name for name in release.trained_on[stage.name]],
            folder / stage.name,
            tell,
            labels=None if stage.pseudo_labels is None else folder / stage.pseudo_labels,
            surfaces=None if stage.normal_labels is None else folder / stage.normal_labels,
            start=None if init is None else _weights(folder, init),
        )
        return
    if _result(folder, stage).is_file():
        tell("done before")
    elif stage.kind == "average":
        tell(f"average of {', '.join(stage.of)}")
        _average(stage, folder)
    elif stage.kind == "normal-labels":
        tell(f"photometric stereo, calibrated with {stage.weights}")
        _compute_normal_labels(release, stage, folder, inputs)
    else:
        tell(f"pseudo-labels by {stage.weights}")
        assert inputs.photographs is not None
        source = photo_folder(inputs.photographs, held_back=NUM_VAL)
        label_photographs(source, _weights(folder, str(stage.weights)), folder / stage.name)


def _average(stage: StageSpec, folder: Path) -> None:
    paths = [_weights(folder, name) for name in stage.of]
    coefficients = stage.coefficients or (1.0,) * len(paths)
    parts = [
        {"sha256": sha256(path), "share": share} for path, share in zip(paths, coefficients, strict=True)
    ]
    metadata = read_metadata(paths[-1]) | {"mean_of": parts}
    save_weights(output_dir(folder / stage.name) / WEIGHTS, average_weights(paths, coefficients), metadata)


def _compute_normal_labels(release: Release, stage: StageSpec, folder: Path, inputs: Inputs) -> None:
    assert inputs.database is not None
    known = open_database("yale-b", inputs.database)
    with progress_bar("reading photographs", len(known.captures())) as advance:
        read = read_image_sets(known, advance)
    prior: tuple[Path, ...] = ()
    if stage.prior_faces is not None:
        prior = (_first_faces(release, stage.prior_faces, folder, inputs),)
    with progress_bar("calibrating lights", len(read.faces)) as advance:
        read = calibrate_image_sets(read, str(_weights(folder, str(stage.weights))), prior, advance)
    with progress_bar("photometric stereo", len(read.faces)) as advance:
        compute_normal_labels(read, folder / stage.name, on_capture=advance)


def _first_faces(release: Release, name: str, folder: Path, inputs: Inputs) -> Path:
    """Return a folder of the first faces of a set: links to their files, and their lines of the manifest."""
    whole, part = folder / "faces" / name, folder / "faces" / f"{name}-prior"
    entries = sorted(Manifest(whole).entries, key=lambda entry: entry.seed)[: release.spec.prior_count]
    if not part.is_dir():
        output_dir(part)
        manifest = Manifest(part, entries[0].spec_hash)
        for entry in entries:
            (part / entry.file).symlink_to((whole / entry.file).resolve())
            manifest.append(entry)
    return part


def _finish(release: Release, folder: Path, inputs: Inputs, command: str) -> list[Record]:
    """Quantize the last weights and write them with their card."""
    name, last = release.spec.name, _weights(folder, release.spec.stage[-1].name)
    final = folder / f"{name}.safetensors"
    save_weights(final, load_weights(last), read_metadata(last), eight_bit=True)
    with progress_bar("measuring: rendering faces", 24) as advance:
        records = measure_shipped(
            [final], folder / "check", command, photographs=inputs.photographs, on_face=lambda _: advance()
        )
    write_records(folder / f"{name}.json", records)
    write_text(folder / f"{name}.md", card_text(release, records))
    return records


def card_text(release: Release, records: list[Record]) -> str:
    """Return the card of a released network: its stages and its numbers."""
    images = sum(recipe.steps * recipe.batch_size for recipe in release.recipes.values())
    stages = "\n".join(
        f"{k}. `{s.name}`: {_describe(release, s)}" for k, s in enumerate(release.spec.stage, 1)
    )
    rows = "\n".join(
        f"| `{r.what}` | {r.value:.4g} | "
        + ("" if r.interval is None else f"{r.interval[0]:.4g} to {r.interval[1]:.4g}")
        + f" | {r.unit} |"
        for r in records
    )
    return (
        f"# {release.spec.name}\n\n{images:,} training images in {len(release.recipes)} training stages.\n\n"
        f"## Stages\n\n{stages}\n\n## Numbers\n\n| what | value | 95 % interval | unit |\n|---|---|---|---|\n"
        f"{rows}\n"
    )


def _describe(release: Release, stage: StageSpec) -> str:
    if stage.kind == "train":
        recipe = release.recipes[stage.name]
        data = ", ".join(release.trained_on[stage.name])
        return f"train {recipe.steps} steps of {recipe.batch_size} images on {data}"
    if stage.kind == "average":
        return f"average {' and '.join(stage.of)}"
    return f"{stage.kind.replace('-', ' ')} by {stage.weights}"


def _result(folder: Path, stage: StageSpec) -> Path:
    names = {"normal-labels": INDEX, "pseudo-labels": MANIFEST}
    return folder / stage.name / names.get(stage.kind, WEIGHTS)


def _missing(folder: Path, stage: StageSpec, inputs: Inputs) -> str:
    """Return the option or file that a stage needs and does not have; a stage before is no such thing."""
    if stage.kind == "normal-labels" and inputs.database is None:
        return "--database (Extended Yale B)"
    if stage.kind == "pseudo-labels" and inputs.photographs is None:
        return "--photographs (a folder with landmarks)"
    for name in (stage.weights, stage.init):
        if name is not None and name.startswith("../") and not _weights(folder, name).is_file():
            return f"{_weights(folder, name)} (train-all of that release, beside this one)"
    return ""


def _weights(folder: Path, name: str) -> Path:
    """Return the weights of a stage here or of a release beside, of a shipped network, or of a file."""
    if name in (*SHIPPED, *HELDOUT):
        return weights_path(name)
    return folder / name if name.endswith(".safetensors") else folder / name / WEIGHTS


def _rendered(folder: Path) -> int:
    return len(Manifest(folder).entries) if folder.is_dir() else 0
