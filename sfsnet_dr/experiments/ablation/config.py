"""``sfsnet-dr ablations``: what each part of the method is worth, and what it costs to render.

Networks that differ in one thing each are trained alike and measured on the same held-back faces.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from sfsnet_dr.core.config import load_toml, with_changes
from sfsnet_dr.core.conventions import FACE_SIZE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.mixed_batch import PseudoLabelOptions
from sfsnet_dr.report.record import dotted_word
from sfsnet_dr.scene.spec import SceneSpec, check_scene, load_scene, refuse_light
from sfsnet_dr.train.config import Recipe, read_recipe, with_environments

#: First seed of the faces that networks are measured on, beyond any that one is trained on.
HELD_SEED: Final = 1_000_000


_RECIPE_LIGHTS = "training images are lit as the recipe's [data.light] says"


@dataclass(frozen=True)
class Variant:
    """One way to train, by what differs from the first.

    Attributes:
        name: a word for records and folders.
        why: what the difference is for, a sentence for readers.
        recipe: values in place of the recipe's.
        scene: values in place of the scene's.
        visibility: whether the rendered shadows and interreflections are learnt from; without, the rendered
            responses are replaced by Lambert's law (``data.no_visibility``).
        price: values in place of the variant's scene, of which a few faces are rendered for their time alone.
            Left out, the price is that of the faces that are learnt from.
    """

    name: str
    why: str
    recipe: dict[str, Any] = field(default_factory=dict)
    scene: dict[str, Any] = field(default_factory=dict)
    visibility: bool = True
    price: dict[str, Any] = field(default_factory=dict)

    @property
    def differs(self) -> bool:
        """Whether it is another than the first."""
        return bool(self.recipe or self.scene or self.price) or not self.visibility


@dataclass(frozen=True)
class AblationsSpec:
    """A set of ablations; paths are relative to its file.

    Attributes:
        recipe: of the first variant.
        scene: likewise.
        variants: the first one differs in nothing; all others are compared with it.
        faces: to train on, the same seeds for every scene.
        held: faces to measure on, of the first variant's scene.
        pictures: photographs of these, each under a light of its own.
        priced: faces that are rendered for their time alone.
        photographs: learn from no more than these many; None takes all.
        seeds: of the trainings; each gives every variant a network.

    Raises:
        InputError: for a number below its least, or variants that cannot be told apart.
    """

    recipe: str
    scene: str
    variants: tuple[Variant, ...]
    faces: int = 96
    held: int = 24
    pictures: int = 96
    priced: int = 6
    photographs: int | None = None
    seeds: tuple[int, ...] = (0,)

    def __post_init__(self) -> None:
        least = {"faces": 1, "held": 2, "pictures": self.held, "priced": 1, "photographs": 1}
        for name, low in least.items():
            value = getattr(self, name)
            if value is not None and value < low:
                raise InputError(f"{name}: {value} found, at least {low} is needed")
        if not self.seeds or len(set(self.seeds)) < len(self.seeds) or min(self.seeds) < 0:
            raise InputError(f"seeds: {list(self.seeds)} found, different numbers of at least 0 are needed")
        names = [variant.name for variant in self.variants]
        for name in names:
            if names.count(name) > 1 or dotted_word(name) != name.replace("-", "_"):
                raise InputError(
                    f"variants: name {name!r} found, different words of a-z, 0-9 and dashes are needed"
                )
        if not names or self.variants[0].differs:
            raise InputError(
                f"variants: {names[0] if names else 'nothing'!r} found first, one that differs in nothing is "
                "needed there"
            )


@dataclass(frozen=True, eq=False)
class Case:
    """A variant with its differences applied."""

    variant: Variant
    recipe: Recipe
    scene: SceneSpec
    price: SceneSpec | None

    @property
    def name(self) -> str:
        """The variant's."""
        return self.variant.name

    @property
    def training(self) -> tuple[Recipe, SceneSpec, bool]:
        """All that decides its networks.

        What a photograph's numbers are (``real.encoding``) does not where no photographs are learnt from.
        """
        recipe = (
            self.recipe
            if self.recipe.real.batch_fraction
            else replace(self.recipe, real=PseudoLabelOptions())
        )
        return recipe, self.scene, self.variant.visibility


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything that is decided before anything is rendered.

    Attributes:
        spec: how much of everything.
        cases: the variants that can run, the first one first.
        left_out: why each other cannot.
        folder: where all is written.
        photographs: folder of photographs to learn from.
        surfaces: folder of labels by photometric stereo to measure on.
    """

    spec: AblationsSpec
    cases: tuple[Case, ...]
    left_out: dict[str, str]
    folder: Path
    photographs: Path | None
    surfaces: Path | None

    @property
    def base(self) -> Case:
        """The first variant."""
        return self.cases[0]

    def rendered(self, case: Case) -> str:
        """The variant whose rendered faces a case shares: the first of the same scene."""
        return next(other.name for other in self.cases if other.scene == case.scene)

    def network(self, case: Case) -> str:
        """The variant whose networks a case shares: the first that is trained alike."""
        return next(other.name for other in self.cases if other.training == case.training)

    @property
    def held(self) -> Path:
        """Folder of the bundles to measure on."""
        return self.folder / "held"

    def faces(self, case: Case) -> Path:
        """Folder of the bundles that a case learns from."""
        kind = "faces" if case.variant.visibility else "no-visibility"
        return self.folder / kind / self.rendered(case)

    def priced(self, case: Case) -> Path:
        """Folder of the bundles whose rendering is a case's price."""
        if case.price is not None:
            return self.folder / "prices" / case.name
        return self.folder / "faces" / self.rendered(case)

    def network_folder(self, name: str, seed: int) -> Path:
        """Of a network."""
        return self.folder / "networks" / f"{name}-{seed}"


def read_ablations(
    path: Path | str,
    out: Path | str,
    *,
    photographs: Path | None = None,
    surfaces: Path | None = None,
    environments: Path | None = None,
    model_path: Path | None = None,
) -> Plan:
    """Read a set of ablations and check that every variant could run, before anything is done.

    Args:
        path: TOML of ``AblationsSpec``.
        out: folder for everything.
        photographs: see ``data.photo_set``; without, variants that learn from photographs are left out.
        surfaces: labels by photometric stereo to measure on.
        environments: folder of environment maps in place of the recipe's.
        model_path: of face models that are read from a file; without, variants with such are left out.

    Raises:
        InputError: for an unusable file, or a variant that cannot be compared with the first.
    """
    path = Path(path)
    try:
        spec = load_toml(AblationsSpec, path)
    except InputError as error:
        raise InputError(f"{error}" if str(error).startswith(str(path)) else f"{path}: {error}") from error
    recipe = with_environments(read_recipe(path.parent / spec.recipe), environments)
    file = path.parent / spec.scene
    scene = refuse_light(load_scene(file), file, _RECIPE_LIGHTS)
    cases, left_out = [], {}
    for variant in spec.variants:
        case = _case(f"{path}: variants: {variant.name}", variant, recipe, scene, model_path)
        missing = _missing(case, photographs)
        if missing is None:
            cases.append(case)
        elif not variant.differs:
            raise InputError(f"{path}: the first variant {missing}")
        else:
            left_out[variant.name] = missing
    return Plan(spec, tuple(cases), left_out, Path(out), photographs, surfaces)


def _case(where: str, variant: Variant, recipe: Recipe, scene: SceneSpec, model_path: Path | None) -> Case:
    own_recipe = with_changes(recipe, variant.recipe, f"{where}: recipe")
    own_scene = with_changes(scene, variant.scene, f"{where}: scene")
    if own_scene.shape != "anny" and model_path is not None:
        own_scene = replace(own_scene, model_path=str(model_path))
    price = with_changes(own_scene, variant.price, f"{where}: price") if variant.price else None
    for part in (own_scene, price or own_scene):
        check_scene(refuse_light(part, where, _RECIPE_LIGHTS), where)
    _check_alike(where, own_recipe, recipe, own_scene)
    return Case(variant, own_recipe, own_scene, price)


def _check_alike(where: str, own: Recipe, first: Recipe, scene: SceneSpec) -> None:
    """What must not differ for errors to be compared."""
    size = first.data.size
    if size is None or scene.camera.size * first.data.crop < size * FACE_SIZE:
        raise InputError(
            f"{where}: camera.size {scene.camera.size} and data.size {size} found, a larger camera is needed"
        )
    pairs = {
        "seed": (own.seed, first.seed),
        "data.size": (own.data.size, size),
        "data.crop": (own.data.crop, first.data.crop),
        "data.num_val": (own.data.num_val, 0),
        "normal_labels.batch_fraction": (own.normal_labels.batch_fraction, 0),
    }
    for key, (found, wanted) in pairs.items():
        if found != wanted:
            raise InputError(f"{where}: recipe: {key} = {found!r} found, {wanted!r} is needed")
    if own.model == first.model:
        return
    try:
        own.make_model()
    except InputError as error:
        raise InputError(f"{where}: recipe: {error}") from error


def _missing(case: Case, photographs: Path | None) -> str | None:
    """What a case lacks to run."""
    if case.recipe.real.batch_fraction and photographs is None:
        return "learns from photographs; --photographs gives them"
    if case.scene.shape != "anny" and case.scene.model_path is None:
        return f"has faces of {case.scene.shape}; --model-path says where that lies"
    return None
