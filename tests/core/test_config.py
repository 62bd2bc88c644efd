"""Dataclasses from TOML: what is accepted, and the one line for everything else."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import pytest

from sfsnet_dr.core.config import added_field, as_dict, fingerprint, load_toml
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.spec import SceneSpec, load_scene


@dataclass(frozen=True)
class Inner:
    RENAMED: ClassVar[dict[str, str]] = {"extent": "size"}
    size: int = 3


@dataclass(frozen=True)
class Outer:
    name: str
    kind: Literal["a", "b"] = "a"
    rate: float = 1.0
    colour: tuple[float, float, float] | None = None
    steps: tuple[int, ...] = ()
    inner: Inner = Inner()


def load(folder: Path, text: str) -> Outer:
    path = folder / "spec.toml"
    path.write_text(text)
    return load_toml(Outer, path)


def test_every_kind_of_value(tmp_path: Path) -> None:
    text = 'name = "x"\nkind = "b"\nrate = 2\ncolour = [0, 0.5, 1]\nsteps = [1, 2]\n[inner]\nsize = 7'
    assert load(tmp_path, text) == Outer("x", "b", 2.0, (0.0, 0.5, 1.0), (1, 2), Inner(7))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('name = "x"\nrat = 1', "unknown key 'rat'; did you mean 'rate'"),
        ('name = "x"\n[inner]\nsise = 1', "inner: unknown key 'sise'"),
        ('name = "x"\n[inner]\nextent = 1', "inner: 'extent' is now called 'size'"),
        ("rate = 1.0", "key 'name' is missing"),
        ('extends = 3\nname = "x"', "extends: 3 found, the path of one TOML file is needed"),
        ('extends = "nowhere.toml"', "nowhere.toml: no such file"),
        ('extends = "spec.toml"', "leads back to a file that extends this one"),
        ("name = 3", "name: 3 found, str is needed"),
        ('name = "x"\nkind = "c"', "kind: 'c' found"),
        ('name = "x"\nrate = true', "rate: True found, float is needed"),
        ('name = "x"\ncolour = [1.0]', "colour: 1 values found, 3 are needed"),
        ('name = "x"\ninner = 3', "inner: 3 found, a table is needed"),
        ('name = "x"\nsteps = 3', "steps: 3 found, an array is needed"),
        ("name = ", "is not valid TOML"),
    ],
)
def test_anything_else_is_one_line_with_file_and_key(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert words in message
    assert "spec.toml" in message
    assert "\n" not in message


def test_a_missing_file_and_one_that_is_no_text(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_toml(Outer, tmp_path / "none.toml")
    (tmp_path / "raw.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot be read as text"):
        load_toml(Outer, tmp_path / "raw.toml")


def test_fingerprints_are_equal_for_equal_specs_only() -> None:
    assert fingerprint(Outer("x")) == fingerprint(Outer("x"))
    assert fingerprint(Outer("x")) != fingerprint(Outer("x", rate=1.5))
    assert as_dict(Outer("x", colour=(0.0, 0.5, 1.0)))["colour"] == [0.0, 0.5, 1.0]


@pytest.mark.parametrize("name", ["faces", "demo_faces", "validation/sphere", "validation/head"])
def test_the_scenes_of_the_repository_load(name: str) -> None:
    path = Path(__file__).parents[2] / "scenes" / f"{name}.toml"
    assert load_scene(path).name == path.stem


def test_the_defaults_are_the_dataset_of_the_repository() -> None:
    path = Path(__file__).parents[2] / "scenes" / "faces.toml"
    assert load_scene(path) == SceneSpec("faces", "anny")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("albedo = [0.5, 1.5, 0.5]", "albedo[1]: 1.5 found, 0.0 to 1.0 allowed"),
        ("[sampling]\nreference_spp = 1", "sampling.reference_spp: 1 found"),
        ("[head]\nyaw = 90.0", "head.yaw: 90.0 found"),
        ("[head]\ndepth_scale = [1.0, 3.0]", "head.depth_scale[1]: 3.0 found, 0.5 to 2.0 allowed"),
        (
            "[head]\ndepth_scale = [1.2, 1.0]",
            "head.depth_scale: 1.2 to 1 found, the smaller number must come first",
        ),
        ("[camera]\nsize = 0", "camera.size: 0 found"),
    ],
)
def test_values_out_of_range_are_refused(tmp_path: Path, line: str, words: str) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(f'name = "x"\nshape = "anny"\n{line}\n')
    with pytest.raises(InputError) as caught:
        load_scene(path)
    assert words in str(caught.value)


def test_a_field_that_came_later_counts_only_when_used() -> None:
    @dataclass(frozen=True)
    class Before:
        rate: float = 0.5

    @dataclass(frozen=True)
    class After:
        rate: float = 0.5
        later: float = added_field(0.0)

    assert fingerprint(Before()) == fingerprint(After())
    assert fingerprint(After()) != fingerprint(After(later=1.0))
    assert as_dict(After(later=1.0)) == {"rate": 0.5, "later": 1.0}


def test_a_file_extends_another_table_by_table(tmp_path: Path) -> None:
    (tmp_path / "base").mkdir()
    (tmp_path / "base" / "far.toml").write_text('name = "far"\nrate = 3.0\n[inner]\nsize = 5')
    (tmp_path / "near.toml").write_text('extends = "base/far.toml"\nkind = "b"\nsteps = [1, 2]')
    found = load(tmp_path, 'extends = "near.toml"\nsteps = [3]\n[inner]\nsize = 8')
    assert found == Outer("far", "b", 3.0, None, (3,), Inner(8))
