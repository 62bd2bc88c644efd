"""What a set of training stages is: its TOML file, its recipes, and where each stage writes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final

from sfsnet_dr.core.config import load_toml
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.normal_dataset import load_training_subjects
from sfsnet_dr.scene.spec import SceneSpec, load_scene, refuse_light
from sfsnet_dr.train.config import Recipe, read_recipe, with_environments

#: Networks in the order in which they are trained; photographs are labelled by the first, before the second.
NETWORKS: Final = ("skipnet-syn", "sfsnet", "sfsnet-syn", "skipnet-plus")
LABELLER: Final = "skipnet-syn"
#: The optional network after them, fine-tuned from the second on normals by photometric stereo.
FINE_TUNED: Final = "sfsnet-ft"
FINE_TUNED_FROM: Final = "sfsnet"


@dataclass(frozen=True)
class StagesSpec:
    """How much of everything a set of stages takes; paths are relative to its file.

    Attributes:
        recipes: folder with a recipe for each of ``NETWORKS``, called NAME.toml.
        faces: bundles to render where no folder of them is given.
        scene: their scene; left out, that of ``sfsnet-dr synth``.
        photographs: learn from no more than these many; None takes all.
        num_val: photographs to measure on.
        pictures: held-back rendered faces to measure on, each image under a light of its own.

    Raises:
        InputError: for a number below its least.
    """

    RENAMED: ClassVar[dict[str, str]] = {"held_back": "num_val"}

    recipes: str
    faces: int = 24
    scene: str | None = None
    photographs: int | None = None
    num_val: int = 500
    pictures: int = 200

    def __post_init__(self) -> None:
        for name, least in (("faces", 1), ("photographs", 1), ("num_val", 1), ("pictures", 2)):
            value = getattr(self, name)
            if value is not None and value < least:
                raise InputError(f"{name}: {value} found, at least {least} is needed")


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything that is decided before the first stage runs.

    Attributes:
        spec: how much of everything.
        recipes: by name of the network.
        scene: of faces that are to be rendered.
        folder: where all stages write.
        data: folders of bundles; empty to render them into ``folder``.
        photographs: folder of photographs; None for rendered ones.
        surfaces: folder of labels by photometric stereo; None leaves out the fine-tuning.
    """

    spec: StagesSpec
    recipes: dict[str, Recipe]
    scene: SceneSpec
    folder: Path
    data: tuple[Path, ...]
    photographs: Path | None
    surfaces: Path | None = None

    @property
    def faces(self) -> tuple[Path, ...]:
        """Folders of bundles."""
        return self.data or (self.folder / "faces",)

    @property
    def labels(self) -> Path:
        """Folder of the pseudo-labels."""
        return self.folder / "pseudo-label"

    @property
    def first(self) -> Recipe:
        """The recipe of the network that labels; all agree with it on images."""
        return self.recipes[LABELLER]


def read_plan(
    path: Path | str,
    out: Path | str,
    *,
    data: Sequence[Path] = (),
    photographs: Path | None = None,
    rendered_photographs: bool = False,
    environments: Path | None = None,
    surfaces: Path | None = None,
) -> Plan:
    """Read a set of stages with its recipes, and check that they go together, before anything is done.

    Args:
        path: TOML of ``StagesSpec``.
        out: folder for everything.
        data: folders of bundles that are there already.
        photographs: see ``data.photo_set``.
        rendered_photographs: let rendered faces stand in for photographs.
        environments: folder of environment maps in place of the recipes'.
        surfaces: labels by photometric stereo to fine-tune on.

    Raises:
        InputError: for unusable files or labels, recipes that do not agree, or neither or both kinds of
            photographs.
    """
    path = Path(path)
    spec = load_toml(StagesSpec, path)
    if (photographs is None) != rendered_photographs:
        found = "neither was given" if photographs is None else "both were given"
        raise InputError(
            f"stages: photographs are needed by pseudo-label, sfsnet and skipnet-plus: {found}; give "
            "--photographs DIR, or --rendered-photographs to let rendered faces stand in for them"
        )
    folder = path.parent / spec.recipes
    recipes = {
        name: with_environments(read_recipe(folder / f"{name}.toml"), environments) for name in NETWORKS
    }
    if surfaces is not None:
        recipes[FINE_TUNED] = with_environments(read_recipe(folder / f"{FINE_TUNED}.toml"), environments)
        load_training_subjects(surfaces, recipes[FINE_TUNED].normal_labels, recipes[FINE_TUNED].data.view)
    _check_alike(folder, recipes)
    scene = SceneSpec("faces", "anny") if spec.scene is None else _load_scene(path.parent / spec.scene)
    return Plan(spec, recipes, scene, Path(out), tuple(data), photographs, surfaces)


def _check_alike(folder: Path, recipes: dict[str, Recipe]) -> None:
    first = recipes[LABELLER]
    for name, recipe in recipes.items():
        pairs = {
            "data.size": (recipe.data.size, first.data.size),
            "data.crop": (recipe.data.crop, first.data.crop),
            "data.num_val": (recipe.data.num_val, first.data.num_val),
            "real.encoding": (recipe.real.encoding, first.real.encoding),
        }
        for key, (found, wanted) in pairs.items():
            if found != wanted:
                raise InputError(
                    f"{folder / name}.toml: {key} = {found!r} found, {wanted!r} as in {LABELLER}.toml needed"
                )
    if first.data.num_val < 1:
        raise InputError(f"{folder / LABELLER}.toml: data.num_val = 0 found, faces to measure on are needed")
    if first.real.batch_fraction:
        raise InputError(
            f"{folder / LABELLER}.toml: real.batch_fraction above 0 found; it labels the photographs"
        )


def _load_scene(path: Path) -> SceneSpec:
    return refuse_light(load_scene(path), path, "training images are lit as the recipe's [data.light] says")
