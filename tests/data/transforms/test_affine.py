"""Moves within the image: a moved ball is a ball elsewhere, and what labels render moves with them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.captures import SIZE, face
from torch import Tensor

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.normal_dataset import NormalLabelFaces, NormalLabelOptions
from sfsnet_dr.data.transforms.affine import InPlane
from sfsnet_dr.render.shading_torch import f_render
from sfsnet_dr.sh.rotation import rotation_matrix

WIDTH, HEIGHT = 96, 64


def move(roll: float, scale: float = 1.0, right: float = 0.0, down: float = 0.0) -> InPlane:
    return InPlane(torch.tensor([roll]), torch.tensor([scale]), torch.tensor([[right, down]]))


def ball(x: float, y: float, radius: float) -> tuple[Tensor, Tensor]:
    """Normals and mask of a ball at pixels to the right of the middle and above it."""
    columns = torch.arange(WIDTH) + 0.5 - WIDTH / 2
    rows = HEIGHT / 2 - torch.arange(HEIGHT) - 0.5
    across, up = (columns[None] - x) / radius, (rows[:, None] - y) / radius
    inside = across**2 + up**2 < 1
    height = (1 - across**2 - up**2).clamp_min(0).sqrt()
    normal = torch.stack([across.expand_as(height), up.expand_as(height), height])
    return (normal * inside)[None], inside.float()[None, None]


@pytest.mark.parametrize(
    ("moved", "where", "radius"),
    [
        (move(0.0), (20.0, 0.0), 12.0),
        (move(math.pi / 2), (0.0, 20.0), 12.0),  # from the right to the top
        (move(-math.pi / 6), (20 * math.cos(math.pi / 6), -10.0), 12.0),
        (move(0.0, 1.25), (25.0, 0.0), 15.0),
        (move(0.0, 1.0, 5.0, 8.0), (25.0, -8.0), 12.0),
        (move(math.pi / 2, 0.8, 5.0, -3.0), (5.0, 19.0), 9.6),
    ],
)
def test_a_moved_ball_is_a_ball_elsewhere(moved: InPlane, where: tuple[float, float], radius: float) -> None:
    normal, mask = ball(20.0, 0.0, 12.0)
    found, inside = moved.normal(normal), moved.mask(mask) > 0
    wanted, wanted_inside = ball(*where, radius)
    assert not bool((inside & ~(wanted_inside > 0)).any())
    assert inside.sum() > 0.75 * wanted_inside.sum()  # but for a rim of one pixel
    steep = inside & (wanted[:, 2:] > 0.5)
    # Bilinear interpolation of a ball's normals: (1 / radius)^2 / 8 / z^3 < 0.01.
    assert float(((found - wanted).norm(dim=1, keepdim=True) * steep).max()) < 0.01


@pytest.mark.parametrize("order", [0, 2, 4])
def test_light_turns_as_by_quadrature(order: int) -> None:
    rng = np.random.default_rng(order)
    light, roll = rng.normal(size=(3, 3, (order + 1) ** 2)), rng.uniform(-3, 3, 3)
    moves = InPlane(torch.from_numpy(roll), torch.ones(3), torch.zeros(3, 2))
    found = moves.light(torch.from_numpy(light.reshape(3, -1))).reshape(light.shape)
    for angle, before, after in zip(roll, light, found.numpy(), strict=True):
        cos, sin = math.cos(angle), math.sin(angle)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        np.testing.assert_allclose(after, before @ rotation_matrix(turn, order).T, atol=1e-12)


def test_what_labels_render_moves_with_them() -> None:
    normal, mask = ball(-6.0, 4.0, 22.0)
    light = torch.linspace(-0.2, 0.6, 27)[None]
    moved = move(0.4, 1.1, 3.0, -2.0)
    image = f_render(normal, 0.5 * mask.expand(-1, 3, -1, -1), light)
    again = f_render(moved.normal(normal), 0.5 * torch.ones_like(image), moved.light(light))
    inside = (moved.mask(mask) > 0) & (moved.normal(normal)[:, 2:] > 0.4)
    # Of an image with values up to 1.5: twice what the normals are off by.
    assert float(((moved.map(image) - again).abs() * inside).max()) < 0.02
    assert float(((moved.map(image) - image).abs() * inside).max()) > 0.1


def test_captures_are_moved_with_their_labels() -> None:
    options = NormalLabelOptions(exposure=0.0, roll=20, scale=0.1, shift=0.1)
    real = NormalLabelFaces([face("a1", 64), face("a2", 64)], 4, options, seed=3)
    batch, still = (
        real.batch(1),
        NormalLabelFaces([face("a1", 64), face("a2", 64)], 4, NormalLabelOptions(exposure=0.0), 3),
    )
    assert not torch.equal(batch.faces.image, still.batch(1).faces.image)
    assert real.names(1) == still.names(1)
    assert 0.4 < float(batch.faces.mask.mean()) < float(still.batch(1).faces.mask.mean())
    norms = batch.faces.normal.norm(dim=1, keepdim=True)[batch.faces.mask > 0]
    torch.testing.assert_close(norms, torch.ones_like(norms))
    parts = [real.batch(1, rank, 2) for rank in (0, 1)]
    for whole, *pieces in zip(batch.faces, *(part.faces for part in parts), strict=True):
        torch.testing.assert_close(torch.cat(pieces), whole)


def test_no_move_draws_nothing() -> None:
    """Runs of recipes without moves go on as before."""
    faces = [face("a3", SIZE)]
    plain = NormalLabelFaces(faces, 2, NormalLabelOptions(), seed=1).batch(5)
    assert NormalLabelOptions().moves(np.random.default_rng(0), 2, SIZE) is None
    tiny = NormalLabelFaces(faces, 2, replace(NormalLabelOptions(), shift=1e-7), seed=1).batch(5)
    for name, planes in plain.faces._asdict().items():
        if name != "mask":
            torch.testing.assert_close(getattr(tiny.faces, name), planes, rtol=1e-4, atol=1e-4)
    assert isinstance(plain.faces, FaceBatch)


@pytest.mark.parametrize("wrong", [{"roll": 50}, {"scale": 0.6}, {"shift": -0.1}])
def test_moves_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match=rf"surfaces\.{next(iter(wrong))}"):
        NormalLabelOptions(**wrong)  # type: ignore[arg-type]
