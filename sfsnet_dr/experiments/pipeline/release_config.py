"""The TOML file of a released network: faces, labels, training stages and averages, in order."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from sfsnet_dr.core.config import build_dataclass, read_toml, with_changes
from sfsnet_dr.core.errors import InputError, nearest
from sfsnet_dr.scene.spec import SceneSpec, load_scene, refuse_light
from sfsnet_dr.train.config import Recipe, with_environments

StageKind = Literal["train", "average", "normal-labels", "pseudo-labels"]


@dataclass(frozen=True)
class FacesSpec:
    """Rendered faces.

    Attributes:
        count: how many.
        scene: scene file, relative to the release file; left out, the default faces.
        face_model: in place of the scene's; ``"ict"`` needs ``--model-path``.
        seed: of the first face.
        minutes: what rendering took on 2 cores, for the estimate.
    """

    count: int
    scene: str | None = None
    face_model: Literal["anny", "ict"] = "anny"
    seed: int = 0
    minutes: float = 0.0


@dataclass(frozen=True)
class StageSpec:
    """One step of the release.

    Attributes:
        name: folder of its result, and how later stages refer to it.
        kind: ``train`` a network; ``average`` checkpoints; compute ``normal-labels`` by uncalibrated
            photometric stereo from the face database; or ``pseudo-labels`` of photographs.
        recipe: keys that differ from the stages before; they hold for the stages after, too.
        faces: names of ``[faces.NAME]`` tables to train on; left out, those of the training stage before.
        init: training: stage or weights to start from; left out, the weights of the stage before;
            ``"random"``.
        normal_labels: training: name of the stage that computed them.
        pseudo_labels: training: name of the stage that computed them.
        weights: labels: stage, shipped network or file that computes them. ``"../skipnet/second"`` is a stage
            of another release beside this one.
        prior_faces: normal labels: name of the faces whose mean orientation and slope are the prior.
        of: average: two or more stages.
        coefficients: average: one for each, any scale.
        minutes: what it took on 2 cores, for the estimate.
    """

    name: str
    kind: StageKind = "train"
    recipe: dict[str, Any] = field(default_factory=dict)
    faces: tuple[str, ...] = ()
    init: str | None = None
    normal_labels: str | None = None
    pseudo_labels: str | None = None
    weights: str | None = None
    prior_faces: str | None = None
    of: tuple[str, ...] = ()
    coefficients: tuple[float, ...] = ()
    minutes: float = 0.0


@dataclass(frozen=True)
class ReleaseSpec:
    """A released network.

    Attributes:
        name: of the file of weights and of the card.
        recipe: the recipe of the first training stage.
        stage: what is done, in order; the last one makes the released weights.
        faces: rendered faces by name.
        prior_count: faces of ``prior_faces`` that are looked at.
    """

    name: str
    recipe: dict[str, Any]
    stage: tuple[StageSpec, ...]
    faces: dict[str, Any] = field(default_factory=dict)
    prior_count: int = 400


@dataclass(frozen=True, eq=False)
class Release:
    """A release that was read and checked.

    Attributes:
        spec: the file.
        faces: rendered faces by name, with their scene.
        recipes: of the training stages, by name.
        trained_on: names of faces of the training stages, by name.
        init: of the training stages: a stage's name, weights, or None for random.
    """

    spec: ReleaseSpec
    faces: dict[str, tuple[FacesSpec, SceneSpec]]
    recipes: dict[str, Recipe]
    trained_on: dict[str, tuple[str, ...]]
    init: dict[str, str | None]


def read_release(path: Path | str, *, environments: Path | None = None) -> Release:
    """Read a release file and check that its stages fit together.

    Args:
        path: TOML of ``ReleaseSpec``.
        environments: folder of environment maps in place of the recipes'.

    Raises:
        InputError: naming the file, the stage and the key: unknown, of another type, missing, or a name that
            no table or stage before has.
    """
    path = Path(path)
    spec = build_dataclass(ReleaseSpec, read_toml(path), str(path))
    if not spec.stage:
        raise InputError(f"{path}: no [[stage]] found, one at least is needed")
    faces = {name: _read_faces(path, name, table) for name, table in spec.faces.items()}
    recipes: dict[str, Recipe] = {}
    trained_on: dict[str, tuple[str, ...]] = {}
    init: dict[str, str | None] = {}
    recipe = build_dataclass(Recipe, spec.recipe, f"{path}: recipe")
    data: tuple[str, ...] = ()
    before: str | None = None
    done: dict[str, StageKind] = {}
    for stage in spec.stage:
        where = f"{path}: stage {stage.name!r}"
        if stage.name in done:
            raise InputError(f"{where}: two stages of this name found, different names are needed")
        _check_references(where, stage, done, faces)
        if stage.kind == "train":
            recipe = with_changes(recipe, stage.recipe, f"{where}: recipe")
            data = stage.faces or data
            if not data:
                raise InputError(f"{where}: faces: none found, name a [faces.NAME] table")
            recipes[stage.name] = with_environments(recipe, environments)
            trained_on[stage.name] = data
            init[stage.name] = None if stage.init == "random" else stage.init or before
            _check_labels(where, stage, recipe)
        if stage.kind in ("train", "average"):
            before = stage.name
        done[stage.name] = stage.kind
    if spec.stage[-1].kind not in ("train", "average"):
        raise InputError(f"{path}: the last stage must train or average; {spec.stage[-1].kind!r} found")
    return Release(spec, faces, recipes, trained_on, init)


def _read_faces(path: Path, name: str, table: Any) -> tuple[FacesSpec, SceneSpec]:
    where = f"{path}: faces.{name}"
    if not isinstance(table, dict):
        raise InputError(f"{where}: {table!r} found, a table is needed")
    faces = build_dataclass(FacesSpec, table, where)
    if faces.count < 1 or faces.seed < 0:
        raise InputError(f"{where}: count {faces.count} and seed {faces.seed} found, at least 1 and 0 needed")
    file = None if faces.scene is None else path.parent / faces.scene
    scene = SceneSpec("faces", "anny") if file is None else load_scene(file)
    return faces, refuse_light(scene, file or where, "training images are lit as the recipe says")


def _check_references(
    where: str, stage: StageSpec, done: dict[str, StageKind], faces: dict[str, Any]
) -> None:
    """Every name that a stage uses must be that of a table, or of a stage before."""
    networks = [name for name, kind in done.items() if kind in ("train", "average")]
    for key, names in (
        ("faces", stage.faces),
        ("prior_faces", () if stage.prior_faces is None else (stage.prior_faces,)),
    ):
        for name in names:
            if name not in faces:
                raise InputError(f"{where}: {key}: {name!r} found; {nearest(name, faces)}")
    for name in stage.of:
        if name not in networks:
            raise InputError(f"{where}: of: {name!r} found; {nearest(name, networks)}")
    for key in ("normal_labels", "pseudo_labels"):
        name, kind = getattr(stage, key), key.replace("_", "-")
        if name is not None and done.get(name) != kind:
            known = [other for other, found in done.items() if found == kind]
            raise InputError(f"{where}: {key}: {name!r} found; {nearest(name, known)}")
    if stage.kind == "average" and len(stage.of) < 2:
        raise InputError(f"{where}: of: {len(stage.of)} stages found, an average needs two at least")
    if stage.kind in ("normal-labels", "pseudo-labels") and stage.weights is None:
        raise InputError(f"{where}: weights is missing: which network computes the labels?")


def _check_labels(where: str, stage: StageSpec, recipe: Recipe) -> None:
    for key, fraction, labels in (
        ("real", recipe.real.batch_fraction, stage.pseudo_labels),
        ("normal_labels", recipe.normal_labels.batch_fraction, stage.normal_labels),
    ):
        if bool(fraction) != (labels is not None):
            found = "no stage of labels" if labels is None else f"labels {labels!r}"
            raise InputError(f"{where}: {key}.batch_fraction = {fraction:g} and {found} found; give both")
