"""The matrix end to end, small: what agrees passes, what is planted is seen, what does not fit is refused."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfsnet_dr.cli.main import main
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.image_io import read_exr, write_exr
from sfsnet_dr.experiments.regression import fault_injection
from sfsnet_dr.experiments.regression.config import (
    CONFIG,
    REFERENCES,
    RegressSpec,
    SceneLights,
    choose_pairs,
    read_spec,
)
from sfsnet_dr.experiments.regression.diagnose import diagnose_difference
from sfsnet_dr.experiments.regression.expected import ExpectedImages
from sfsnet_dr.experiments.regression.fault_injection import DEFECTS, InjectedFault
from sfsnet_dr.experiments.regression.matrix import (
    compare_pair,
    load_subjects,
    models_of_renderers,
    run_matrix,
)
from sfsnet_dr.experiments.regression.references import References, light_hash, make_references, scene_hash
from sfsnet_dr.render.renderers.registry import find_renderer
from sfsnet_dr.scene.spec import SamplingSpec

GROUND = (SceneLights("sphere", ("two_colours",)), SceneLights("two_spheres", ("natural0",)))
RENDERERS = ("numpy-order2", "drjit-order4", "drjit-order4-visibility", "mitsuba-llvm-path")
SMALL = RegressSpec(
    scenes=GROUND,
    renderers=RENDERERS,
    size=32,
    seeds=4,
    samples=32,
    reference_samples=512,
    reference_maps=512,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """References of the small matrix."""
    made = tmp_path_factory.mktemp("references")
    stored = replace(SMALL, scenes=GROUND[1:])
    make_references(
        SMALL, made, load_subjects(stored), lambda subject: models_of_renderers(RENDERERS, subject)
    )
    return made


def config(folder: Path) -> Path:
    """The small matrix as a file."""
    scenes = "".join(f'[[scenes]]\nscene = "{p.scene}"\nlights = {list(p.lights)}\n' for p in GROUND)
    numbers = "".join(
        f"{name} = {getattr(SMALL, name)}\n"
        for name in ("size", "seeds", "samples", "reference_samples", "reference_maps")
    )
    path = folder / "matrix.toml"
    path.write_text(f"renderers = {list(RENDERERS)}\n{numbers}{scenes}")
    return path


def test_renderers_agree_with_what_they_should_show(folder: Path) -> None:
    rows = run_matrix(SMALL, References(folder))
    assert len(rows) == 8
    assert [row.verdict for row in rows] == ["agrees"] * 8
    assert {row.truth.kind for row in rows if row.truth} == {"formula", "stored maps", "path tracing"}


@pytest.mark.slow
def test_every_planted_defect_is_seen(folder: Path) -> None:
    found = fault_injection.inject_faults(SMALL, References(folder), 100, ground=GROUND, search=False)
    assert {item.defect.kind for item in found} == {
        "albedo", "light_direction", "swapped_axis", "half_pixel", "missing_cosine", "srgb_twice", "order",
    }  # fmt: skip
    assert [f"{item.defect.kind} in {item.host}" for item in found if not item.caught] == []
    causes = {item.defect.kind: item.cause for item in found if item.suffix == ".noise_free"}
    for kind, words in {
        "albedo": "brightness x +1.0",
        "light_direction": "the light turned",
        "swapped_axis": "x and y axes exchanged",
        "half_pixel": "moved by +0.5",
        "srgb_twice": "sRGB curve",
        "order": "light of order 2",
    }.items():
        assert words in causes[kind], kind


def test_a_defect_of_one_percent_is_seen_and_named(folder: Path) -> None:
    """The quick part of the above: a path tracer and a shading model whose albedo is 1 % too bright."""
    [defect] = [defect for defect in DEFECTS if defect.kind == "albedo"]
    library = References(folder)
    for (subject, [light]), name in itertools.product(
        load_subjects(SMALL), ("drjit-order4", "mitsuba-llvm-path")
    ):
        spoiled = InjectedFault(find_renderer(name), defect, defect.size)
        row = compare_pair(
            name, fault_injection.direct_image(spoiled), ExpectedImages(subject, light, library), SMALL
        )
        assert row.p < 1e-4, (name, subject.spec.name)
        if name == "drjit-order4":
            assert row.image is not None
            assert row.truth is not None
            assert "brightness x +1.0" in diagnose_difference(row.image, row.truth).words


def test_a_failing_pair_ends_with_1_and_leaves_its_evidence(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Brightened maps: shading models now differ from them, the path tracer does not."""
    spoiled = tmp_path / "references"
    spoiled.mkdir()
    for path in folder.glob("*.exr"):
        planes, metadata = read_exr(path)
        if path.name == "two_spheres.maps.exr":
            planes |= {name: 1.02 * planes[name] for name in planes if name.startswith("albedo.")}
        ours = {key: value for key, value in metadata.items() if key.startswith("sfsnet_dr:")}
        write_exr(spoiled / path.name, planes, ours, float32=set(planes))
    out = tmp_path / "out"
    command = ["regress", "--out", str(out), "--references", str(spoiled), "--config", str(config(tmp_path))]
    arguments = ["--renderers", "numpy-order2,mitsuba-llvm-path", "--scenes", "two_spheres", "--json"]
    assert main([*command, *arguments]) == 1
    records = {record["what"]: record["value"] for record in json.loads(capsys.readouterr().out)}
    assert (records["regress.pairs"], records["regress.differing"]) == (2, 1)
    [failure] = (out / "failures").iterdir()
    assert failure.name == "numpy_order2-two_spheres-natural0"
    assert {path.name for path in failure.iterdir()} == {
        "cause.txt", "images.exr", "image.png", "reference.png", "difference.png", "p_values.png",
    }  # fmt: skip
    assert "brightness x -1.9" in (failure / "cause.txt").read_text()
    page = (out / "index.html").read_text()
    assert "DIFFERS" in page
    assert "brightness x -1.9" in page


def test_what_does_not_fit_is_refused_in_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def said(*arguments: str) -> str:
        base = ["regress", "--out", str(tmp_path), "--config", str(config(tmp_path))]
        assert main([*base, *arguments]) == 2
        [line] = capsys.readouterr().err.strip().splitlines()
        return line

    assert "did you mean 'numpy-order2'?" in said("--renderers", "numpy-ordr2")
    assert "did you mean 'two_spheres'?" in said("--scenes", "two_sphere")
    assert "light 'natural9': not in the matrix; did you mean 'natural0'?" in said("--lights", "natural9")
    at = ["--scenes", "two_spheres", "--renderers", "numpy-order2", "--references"]
    assert "no such reference; `sfsnet-dr regress --update`" in said(*at, str(tmp_path / "none"))
    planes, metadata = read_exr(folder / "two_spheres.maps.exr")
    ours = {key: value for key, value in metadata.items() if key.startswith("sfsnet_dr:")}
    for key in ("scene hash", "mitsuba", "format"):
        other = tmp_path / key.replace(" ", "-")
        other.mkdir()
        changed = ours | {f"sfsnet_dr:{key}": "0.0"}
        write_exr(other / "two_spheres.maps.exr", planes, changed, float32=set(planes))
        assert f"made for {key} 0.0" in said(*at, str(other))


def test_a_light_is_known_by_its_numbers() -> None:
    (_, [light]) = next(iter(load_subjects(replace(SMALL, scenes=GROUND[:1]))))
    assert light_hash(light) == light_hash(light.scaled(1 + 1e-12))
    assert light_hash(light) != light_hash(light.turned(np.diag([-1.0, -1.0, 1.0])))


def test_a_scene_is_known_by_what_its_file_says() -> None:
    [(subject, _)] = load_subjects(replace(SMALL, scenes=GROUND[:1]))
    same = replace(subject, spec=replace(subject.spec, sampling=SamplingSpec(reference_spp=2)))
    assert scene_hash(subject) == scene_hash(same)
    for other in (
        replace(subject, seed=1),
        replace(subject, spec=replace(subject.spec, albedo=(0.5, 0.5, 0.51))),
        replace(subject, spec=replace(subject.spec, camera=replace(subject.spec.camera, distance=11.0))),
    ):
        assert scene_hash(other) != scene_hash(subject)


def test_the_matrix_of_the_repository_is_sound() -> None:
    spec = read_spec(CONFIG)
    assert choose_pairs(spec, "sphere", None, None).scenes[0].scene == "sphere"
    with pytest.raises(InputError, match="scene 'spher'"):
        choose_pairs(spec, "spher", None, None)


@pytest.mark.regress
@pytest.mark.slow
def test_all_renderers_agree() -> None:
    """The whole matrix against the stored references: `pytest -m regress`."""
    rows = run_matrix(read_spec(CONFIG), References(REFERENCES))
    wrong = [(row.renderer, row.scene, row.light, row.detail, row.p) for row in rows
             if row.verdict in ("differs", "failed")]  # fmt: skip
    assert wrong == []
