"""One step of training: it learns, and it does nothing at all on numbers that are not finite."""

from __future__ import annotations

import pytest
import torch
from helpers.spheres import write_spheres

from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.dataset import RelitFaces, load_faces
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.data.transforms.camera import PhotoOptions
from sfsnet_dr.scene.lights.spec import LightSpec
from sfsnet_dr.train.config import ComputeRecipe, ModelRecipe, OptimiserRecipe, Precision, Recipe
from sfsnet_dr.train.step import NonFiniteError, training_step

SMALL = ModelRecipe(stem=8, features=16, blocks=1)


@pytest.fixture(scope="module")
def batch(tmp_path_factory: pytest.TempPathFactory) -> FaceBatch:
    """Four relit spheres of 16 x 16."""
    faces = load_faces(write_spheres(tmp_path_factory.mktemp("faces"), 4))
    light = LightSpec(hdr=0, sun_sky=0, studio=0, directional=0, ambient=0, lobes=1)
    augmentation = Augmentation(
        num_lights=4, light=light, photo=PhotoOptions(noise=0.0, jpeg=0.0, grayscale_prob=0.0)
    )
    return RelitFaces(faces, 4, augmentation, seed=0).batch(0)


def recipe(precision: Precision = "float32") -> Recipe:
    """A recipe for a small network."""
    compute = ComputeRecipe(precision=precision, loss_backend="torch")
    return Recipe(steps=1, batch_size=4, model=SMALL, compute=compute, optimiser=OptimiserRecipe())


#: Share of the first loss that may be left after 60 steps: twice the worst of two seeds and two precisions
#: (0.042, 0.055, 0.028, 0.066, 0.025).
SHARES = {"total": 0.085, "recon": 0.11, "normal": 0.06, "albedo": 0.13, "light": 0.05}


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_one_batch_is_learnt_by_heart(batch: FaceBatch, precision: Precision) -> None:
    torch.manual_seed(0)
    model = SMALL.make().train()
    adam = torch.optim.Adam(model.parameters())
    terms = [training_step(model, adam, batch, recipe(precision), 1e-2) for _ in range(60)]
    first, last = terms[0], terms[-1]
    for name, share in SHARES.items():
        assert last[name] < share * first[name], (name, first[name], last[name])


def state(model: torch.nn.Module, adam: torch.optim.Adam) -> list[torch.Tensor]:
    """Copies of all tensors that a step may change."""
    tensors = [tensor.clone() for tensor in model.state_dict().values()]
    return tensors + [t.clone() for values in adam.state.values() for t in values.values()]


@pytest.mark.parametrize("field", ["image", "albedo"])
def test_a_batch_that_is_not_finite_changes_nothing(batch: FaceBatch, field: str) -> None:
    model = SMALL.make().train()
    adam = torch.optim.Adam(model.parameters())
    training_step(model, adam, batch, recipe(), 1e-2)
    before = state(model, adam)
    spoilt = getattr(batch, field).clone()
    spoilt[1, 2, 8, 8] = float("nan")
    with pytest.raises(NonFiniteError, match="total"):
        training_step(model, adam, batch._replace(**{field: spoilt}), recipe(), 1e-2)
    after = state(model, adam)
    assert len(before) == len(after)
    assert all(torch.equal(a, b) for a, b in zip(before, after, strict=True))
    training_step(model, adam, batch, recipe(), 1e-2)
    assert not all(torch.equal(a, b) for a, b in zip(before, state(model, adam), strict=True))


def test_the_gradient_is_clipped(batch: FaceBatch) -> None:
    model = SMALL.make().train()
    adam = torch.optim.Adam(model.parameters())
    values = training_step(model, adam, batch, recipe(), 1e-2)
    clipped = [p.grad.norm() for p in model.parameters() if p.grad is not None]
    assert values["gradient"] > 1
    assert float(torch.stack(clipped).norm()) == pytest.approx(1, rel=1e-4)
