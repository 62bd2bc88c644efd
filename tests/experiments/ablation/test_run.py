"""Ablations: variants differ in what they say alone, each network is trained once, and numbers are paired."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.spheres import sphere_bundle, write_spheres
from rich.console import Console

from sfsnet_dr.core.config import fingerprint
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.core.provenance import sha256
from sfsnet_dr.data.bundle import write_bundle
from sfsnet_dr.data.manifest import Entry, Manifest
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.experiments.ablation.config import read_ablations
from sfsnet_dr.experiments.ablation.measure import compare_variants
from sfsnet_dr.experiments.ablation.run import run_ablations
from sfsnet_dr.losses.reconstruction import Backend
from sfsnet_dr.report.record import read_records
from sfsnet_dr.scene.lights.spec import LightSpec
from sfsnet_dr.scene.spec import SceneSpec
from sfsnet_dr.train.config import ComputeRecipe, ModelRecipe, Recipe
from sfsnet_dr.train.logging import read_history
from sfsnet_dr.train.trainer import train

ROOT = Path(__file__).parents[3]
SET = """
recipe = "base.toml"
scene = "scene.toml"
faces = 3
held = 2
pictures = 4
priced = 1
seeds = [0, 1]
[[variants]]
name = "base"
why = "all"
[[variants]]
name = "display"
why = "encoded values"
recipe.real.encoding = "srgb"
[[variants]]
name = "no-visibility"
why = "no shadows"
visibility = false
price.sampling = { max_bounces = 0, directional_lights = 0 }
[[variants]]
name = "torch-loss"
why = "rounding"
recipe.compute.loss_backend = "torch"
[[variants]]
name = "ict"
why = "other faces"
scene.shape = "ict"
[[variants]]
name = "photographs"
why = "real ones"
recipe.real.batch_fraction = 0.5
"""
RECIPE = """
steps = 2
batch_size = 2
[model]
architecture = "skipnet"
width = 2
[data]
size = 32
num_lights = 4
light = { hdr = 0.0, sun_sky = 0.0, studio = 0.0, directional = 1.0 }
[compute]
precision = "float32"
"""


def write_set(folder: Path, change: Callable[[str], str] = lambda text: text) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "base.toml").write_text(RECIPE)
    (folder / "scene.toml").write_text('name = "tiny"\nshape = "anny"\n[camera]\nsize = 32\n')
    (folder / "set.toml").write_text(change(SET))
    return folder / "set.toml"


def render_spheres(
    folder: Path, scene: SceneSpec, count: int, *, seed: int, resume: bool, on_face: Callable[[int], None]
) -> None:
    """What ``synthesize`` does, with spheres for faces."""
    folder.mkdir(parents=True, exist_ok=True)
    manifest = Manifest(folder, fingerprint(scene))
    for each in range(seed, seed + count):
        path = folder / f"face-{each:06d}.exr"
        write_bundle(path, sphere_bundle(each, 32))
        manifest.append(Entry(path.name, each, "sphere", fingerprint(scene), sha256(path)))
        on_face(each)


@pytest.fixture
def trainings(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the networks that are trained from now on, of spheres."""
    names: list[str] = []

    def training(recipe: Recipe, faces: Any, folder: Path, **more: Any) -> object:
        names.append(folder.name)
        return train(recipe, faces, folder, progress=False, **more)

    monkeypatch.setattr("sfsnet_dr.experiments.pipeline.cache.synthesize", render_spheres)
    monkeypatch.setattr("sfsnet_dr.experiments.pipeline.cache.train", training)
    return names


def test_variants_are_trained_once_and_compared(
    tmp_path: Path, trainings: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    plan = read_ablations(write_set(tmp_path / "set"), out)
    assert set(plan.left_out) == {"ict", "photographs"}
    records = run_ablations(plan, command="sfsnet-dr ablations", console=Console(quiet=True))
    assert trainings == [f"{n}-{seed}" for n in ("base", "no-visibility", "torch-loss") for seed in (0, 1)]
    what = {record.what: record for record in records}
    for name in ("base", "display", "no-visibility", "torch-loss"):
        assert 0 < what[f"ablations.{name}.synthetic.normals.mean_deg"].value < 180
        assert what[f"ablations.{name}.seconds_per_face"].value > 0
        assert what[f"ablations.{name}.synthetic.normals.seed_std_deg"].value > 0
    assert "ablations.base.synthetic.normals.difference_deg" not in what
    assert "ablations.display.training_seconds" not in what
    # The same network, but what it is shown is encoded.
    assert abs(what["ablations.display.synthetic.normals.difference_deg"].value) > 1e-3
    # Spheres have no shadows: half floats and their like are all that differs.
    assert abs(what["ablations.no-visibility.synthetic.normals.difference_deg"].value) < 0.1
    assert abs(what["ablations.torch-loss.synthetic.normals.difference_deg"].value) < 0.1
    assert what["ablations.torch-loss.loss.first_difference"].value < 1e-5
    assert what["ablations.data.synthetic.images"].value == 4
    assert read_records(out / "records.json") == records
    page = (out / "index.html").read_text(encoding="utf-8")
    assert "ict was left out: it has faces of ict; --model-path says where that lies." in page
    assert "trained from 2 seeds" in page

    trainings.clear()
    monkeypatch.setattr("sfsnet_dr.experiments.ablation.run.write_results", lambda *_: [])
    run_ablations(plan, command="", console=Console(quiet=True))
    assert not trainings, "nothing is trained twice"
    fewer = read_ablations(write_set(tmp_path / "set", lambda t: t.replace("faces = 3", "faces = 2")), out)
    with pytest.raises(InputError, match="3 faces found, 2 asked for; choose another --out"):
        run_ablations(fewer, command="", console=Console(quiet=True))


def test_differences_are_paired_by_person_and_seed() -> None:
    first = [np.array([[1.0, 10, 0.5], [3, 90, 1.5]]), np.array([[1.0, 12, 0.5], [3, 90, 1.5]])]
    own = [rows + np.array([0, 1, 0]) * rows[:, :1] for rows in first]
    found = compare_variants(own, first)
    assert found.mean == pytest.approx((11 + 93 + 13 + 93) / 8)
    assert found.below20 == pytest.approx(50)
    assert found.difference == pytest.approx(1)
    # Every person is one degree worse, whoever is drawn, though people differ by twenty.
    np.testing.assert_allclose(found.difference_ends, 1, atol=1e-9)
    assert found.mean_ends[0] == pytest.approx(12)
    assert found.mean_ends[1] == pytest.approx(31)
    np.testing.assert_allclose(found.each, 1)
    assert found.std == pytest.approx(np.std([104 / 4, 106 / 4], ddof=1))
    assert found.difference_std == pytest.approx(0, abs=1e-9)
    assert compare_variants(own[:1], first[:1]).std is None


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("faces = 3", "facez = 3", "unknown key 'facez'; did you mean 'faces'"),
        (
            "recipe.real.encoding",
            "recipe.real.encodinq",
            "display: recipe: real: unknown key 'encodinq'; did you mean",
        ),
        ('"srgb"\n[[', "3\n[[", r"display: recipe: real: encoding: 3 found; allowed: linear, srgb"),
        (
            'scene.shape = "ict"',
            "scene.head.yaw = 90.0",
            r"ict: head\.yaw: 90\.0 found, 0\.0 to 60\.0 allowed",
        ),
        ('scene.shape = "ict"', "scene.head = 3", "ict: scene: head: 3 found, a table is needed"),
        ('scene.shape = "ict"', "recipe = 3", "recipe: 3 found, a table is needed"),
        ('scene.shape = "ict"', "recipe.data.size = 64", r"data\.size = 64 found, 32 is needed"),
        ('scene.shape = "ict"', "recipe.seed = 4", "recipe: seed = 4 found, 0 is needed"),
        (
            'scene.shape = "ict"',
            "recipe.real.batch_fraction = 0.1",
            "ict: recipe: real.batch_fraction: 0.1 of 2 images is 0",
        ),
        ('why = "all"', 'why = "all"\nvisibility = false', "'base' found first, one that differs in nothing"),
        ('"torch-loss"', '"base"', "name 'base' found, different words"),
        ('"torch-loss"', '"a/b"', "name 'a/b' found, different words"),
        ("pictures = 4", "pictures = 1", "pictures: 1 found, at least 2 is needed"),
        ("seeds = [0, 1]", "seeds = [1, 1]", r"seeds: \[1, 1\] found, different numbers"),
        ('"no shadows"', "", "is not valid TOML"),
    ],
)
def test_a_set_that_cannot_be_compared_is_refused_in_one_line(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    assert old in SET
    path = write_set(tmp_path, lambda text: text.replace(old, new, 1))
    with pytest.raises(InputError, match=words) as found:
        read_ablations(path, tmp_path / "out")
    assert "\n" not in str(found.value)
    assert str(path) in str(found.value)
    assert not (tmp_path / "out").exists()


def test_the_set_of_the_repository_is_read(tmp_path: Path) -> None:
    path = ROOT / "training" / "ablations.toml"
    alone = read_ablations(path, tmp_path / "out")
    assert set(alone.left_out) == {"ict", "photographs", "display-photographs"}
    plan = read_ablations(path, tmp_path / "out", photographs=tmp_path, model_path=tmp_path / "ict.npz")
    assert not plan.left_out
    cases = {case.name: case for case in plan.cases}
    trained = {name: plan.network(case) for name, case in cases.items()}
    assert trained == {name: "base" if name == "display" else name for name in cases}
    rendered = {plan.rendered(case) for case in plan.cases}
    assert rendered == {"base", "no-gloss", "no-relief", "ict"}
    assert not cases["no-gloss"].scene.has_gloss
    assert not cases["no-relief"].scene.head.relief


def losses(folder: Path, faces: Path, backend: Backend) -> list[dict[str, float]]:
    recipe = Recipe(
        steps=6,
        batch_size=4,
        model=ModelRecipe("skipnet", width=4),
        data=Augmentation(size=32, num_lights=4, light=LightSpec(hdr=0, sun_sky=0, studio=0, directional=1)),
        compute=ComputeRecipe(precision="float32", loss_backend=backend),
    )
    return read_history(train(recipe, faces, folder, progress=False).history)


#: Greatest relative difference of what six steps tell. Float32 rounds by 6e-8; found were 2e-7, and 2e-5 in
#: the norm of the gradient, whose signs of |x| turn where x is near 0. Both times ten or more.
DIFFERENT = 5e-6
DIFFERENT_GRADIENT = 2e-4


def test_training_is_the_same_whoever_computes_the_loss(tmp_path: Path) -> None:
    faces = write_spheres(tmp_path / "faces", 3, size=32)
    a, b = (losses(tmp_path / name, faces, name) for name in ("drjit", "torch"))
    for step, other in zip(a, b, strict=True):
        for term in ("total", "recon", "normal", "albedo", "light"):
            assert step[term] == pytest.approx(other[term], rel=DIFFERENT), (step["step"], term)
        assert step["gradient"] == pytest.approx(other["gradient"], rel=DIFFERENT_GRADIENT), step["step"]
    assert a[-1]["recon"] != pytest.approx(a[0]["recon"], rel=100 * DIFFERENT), "it learns meanwhile"


@pytest.mark.slow
def test_the_command_renders_trains_and_measures_on_photographs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from helpers.captures import write_faces

    from sfsnet_dr.cli.main import main

    path = write_set(tmp_path / "set", lambda text: text.replace("seeds = [0, 1]", "seeds = [0]"))
    surfaces = write_faces(tmp_path / "labels", size=128)
    out = tmp_path / "out"
    code = main(["ablations", str(path), "--out", str(out), "--normal-labels", str(surfaces), "--json"])
    assert code == 0
    what = {record["what"]: record for record in json.loads(capsys.readouterr().out)}
    for kind in ("synthetic", "measured"):
        low, high = what[f"ablations.no-visibility.{kind}.normals.difference_deg"]["interval"]
        assert low <= high
    assert what["ablations.data.measured.people"]["value"] == 6
    prices = [what[f"ablations.{name}.seconds_per_face"]["value"] for name in ("base", "no-visibility")]
    assert min(prices) > 0.05
