"""``sfsnet-dr validate``: models and renderers measured on one scene, as records, a table and a page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.files import atomic_path, output_dir, write_text
from sfsnet_dr.experiments.validation.measure import LightResult, SceneResults, measure_models
from sfsnet_dr.experiments.validation.records import main_records, study_records, to_csv
from sfsnet_dr.experiments.validation.renderers import RendererResult, chosen_renderers, compare_renderers
from sfsnet_dr.experiments.validation.summary import Study, summary_sentence
from sfsnet_dr.experiments.validation.timing import measure_cold_start, time_model
from sfsnet_dr.render.renderers.registry import is_built_in
from sfsnet_dr.report.console import progress_bar
from sfsnet_dr.report.record import Record, write_records
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.lights.presets import light_set
from sfsnet_dr.scene.spec import load_scene
from sfsnet_dr.scene.subject import Subject, build_subject, load_spec_by_name, validation_scenes


@dataclass(frozen=True)
class Request:
    """What to validate, and what to spend.

    Attributes:
        scene: a name of ``scenes/validation`` or a file.
        lights: names of sets or lights, with commas between (``scene.light_sets``).
        tolerance: relative RMS error that is allowed.
        renderers: ``all``, ``none`` or names with commas between.
        samples: paths per pixel of each reference; the scene says if None.
        size: edge of the image in pixels; the scene says if None.
        seed: of a head and of all noise.
        environments: folder of environment maps that join the lights.
        model_path: where the scene's face model lies.
        command: what the records say measured them.
    """

    scene: Path | str
    lights: str = "standard"
    tolerance: float = 0.05
    renderers: str = "all"
    samples: int | None = None
    size: int | None = None
    seed: int = 0
    environments: Path | None = None
    model_path: Path | None = None
    command: str = "sfsnet-dr validate"


def validate(request: Request, out: Path | str) -> tuple[list[Record], str]:
    """Measure and write ``records.json``, ``errors.csv``, ``pareto.png``, ``maps/`` and ``index.html``.

    Returns:
        The records, and the sentence that names the cheapest model within the tolerance.

    Raises:
        InputError: for an unknown scene, light or renderer, a light of all zeros, a scene with no surface in
            view, or a tolerance or number that makes no sense.
    """
    from sfsnet_dr.experiments.validation.page import draw_pareto, error_maps, write_study_page

    subject, lights = _subject(request), light_set(request.lights, request.environments)
    names, folder = chosen_renderers(request.renderers), output_dir(out)
    study = measure_scene(subject, lights, names, samples=request.samples, seed=request.seed)
    found = study_records(study, request.tolerance, request.command, request.seed)
    write_records(folder / "records.json", found)
    write_text(folder / "errors.csv", to_csv(study))
    maps = output_dir(folder / "maps")
    pictures = {maps / f"{name}.png": picture for name, picture in error_maps(study).items()}
    for path, picture in ({folder / "pareto.png": draw_pareto(study)} | pictures).items():
        with atomic_path(path) as unfinished:
            unfinished.write_bytes(picture)
    write_study_page(folder / "index.html", study, request.tolerance, found[0])
    return found, summary_sentence(study, request.tolerance)


def validate_all(request: Request, out: Path | str, skipped: Callable[[str], None]) -> list[Record]:
    """Validate every scene into a folder of its name, and write the main records of all of them together.

    Args:
        request: its scene is not looked at.
        out: folder for all of it; ``records.json`` holds what ``records.main_records`` chooses, and
            ``errors.csv`` every line.
        skipped: called with the reason for a scene whose face model is not given.
    """
    folder, found, tables = output_dir(out), [], []
    for scene, path in validation_scenes().items():
        if load_scene(path).shape == "ict" and request.model_path is None:
            skipped(f"{scene}: left out; it needs --model-path")
            continue
        records, _ = validate(replace(request, scene=scene), folder / scene)
        found += main_records(records)
        tables.append((folder / scene / "errors.csv").read_text(encoding="utf-8").splitlines(keepends=True))
    write_records(folder / "records.json", found)
    write_text(
        folder / "errors.csv", "".join([*tables[0][:1], *(line for table in tables for line in table[1:])])
    )
    return found


def measure_scene(
    subject: Subject,
    lights: Sequence[Light],
    renderers: Sequence[str] = (),
    *,
    samples: int | None = None,
    seed: int = 0,
    cold: bool = True,
) -> Study:
    """Everything about one scene, under a progress bar.

    Args:
        subject: what is seen.
        lights: under which.
        renderers: names of the renderers that are compared too: ours under one soft and one hard light,
            those of other packages under every light, like the shading models.
        samples: paths per pixel of each reference.
        seed: of all noise.
        cold: whether first calls are timed, in a process of their own.
    """
    name = subject.spec.name
    with progress_bar(f"{name}: lights", len(lights)) as advance:
        measured = measure_models(subject, lights, samples=samples, seed=seed, on_light=lambda _: advance())
    gloss = subject.spec.has_gloss
    first = measure_cold_start(subject.camera.size, gloss) if cold else {}
    study = Study(measured, {}, first)
    with progress_bar(f"{name}: times", len(study.models)) as advance:
        times = {}
        for model in study.models:
            times[model.key] = time_model(measured.inputs, model, lights[0])
            advance()
    return replace(study, times=times, renderers=_compare(measured, renderers))


def _subject(request: Request) -> Subject:
    if not 0 < request.tolerance < 10:
        raise InputError(f"--tolerance: {request.tolerance:g} found, a ratio above 0 and below 10 allowed")
    spec = load_spec_by_name(request.scene, request.model_path)
    if request.samples is not None and not 2 <= request.samples <= 65536:
        raise InputError(f"--samples: {request.samples} found, 2 to 65536 allowed")
    if request.size is not None:
        if not 16 <= request.size <= 1024:
            raise InputError(f"--size: {request.size} found, 16 to 1024 allowed")
        spec = replace(spec, camera=replace(spec.camera, size=request.size))
    return build_subject(spec, request.seed)


def _compare(measured: SceneResults, names: Sequence[str]) -> tuple[RendererResult, ...]:
    few = lights_for_renderers(measured.results)
    lights = {name: few if is_built_in(name) else measured.results for name in names}
    total = sum(len(results) for results in lights.values())
    with progress_bar(f"{measured.name}: renderers", max(total, 1)) as advance:
        return compare_renderers(measured, lights, lambda _: advance())


def lights_for_renderers(results: Sequence[LightResult]) -> list[LightResult]:
    """One soft light, a natural one if there is, and the last of the single hard lamps."""
    soft = sorted((r for r in results if not r.hard), key=lambda r: not r.light.name.startswith("natural"))
    hard = [r for r in results if r.hard and r.light.environment is None]
    return [*soft[:1], *hard[-1:]]
