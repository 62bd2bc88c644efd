"""The paper's total loss, term by term, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.batch import FaceBatch
from sfsnet_dr.data.mixed_batch import RealBatch
from sfsnet_dr.losses.reconstruction import Backend
from sfsnet_dr.losses.sfsnet import (
    LabelConfidence,
    LossTerms,
    LossWeights,
    light_confidence,
    masked_l1,
    sfsnet_loss,
)
from sfsnet_dr.models.base import NetworkOutput
from sfsnet_dr.render.shading_numpy import f_render


def _faces(seed: int = 0, batch: int = 2, size: int = 6) -> tuple[NetworkOutput, FaceBatch]:
    rng = torch.Generator().manual_seed(seed)

    def random(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=rng)

    shape = (batch, 3, size, size)
    prediction = NetworkOutput(random(*shape), random(*shape).abs(), random(batch, 27))
    mask = (random(batch, 1, size, size) > 0).float()
    target = FaceBatch(random(*shape).abs(), random(*shape), random(*shape).abs(), random(batch, 27), mask)
    return NetworkOutput(*(t.requires_grad_() for t in prediction)), target


@pytest.mark.parametrize("backend", ["drjit", "torch"])
def test_every_term_and_the_total(backend: Backend) -> None:
    prediction, target = _faces()
    terms = sfsnet_loss(prediction, target, backend=backend)
    normal, albedo, light = (t.detach().double().numpy() for t in prediction)
    image, true_normal, true_albedo, true_light, mask = (t.double().numpy() for t in target)
    count = 3 * mask.sum()
    expected = [
        (mask * np.abs(f_render(normal, albedo, light) - image)).sum() / count,
        (mask * np.abs(normal - true_normal)).sum() / count,
        (mask * np.abs(albedo - true_albedo)).sum() / count,
        ((light - true_light) ** 2).sum() / (2 * 27),
    ]
    # Float32 sums of some hundred terms; worst seen 2e-7.
    assert [t.item() for t in terms[1:]] == pytest.approx(expected, rel=1e-6)
    assert terms.total.item() == pytest.approx(np.dot([0.5, 0.5, 0.5, 0.1], expected), rel=1e-6)


def test_weights_choose_the_terms() -> None:
    prediction, target = _faces()
    for name in ("recon", "normal", "albedo", "light"):
        weights = LossWeights(**{n: float(n == name) * 2 for n in ("recon", "normal", "albedo", "light")})
        terms = sfsnet_loss(prediction, target, weights, "torch")
        assert terms.total.item() == pytest.approx(2 * getattr(terms, name).item(), rel=1e-6)


def test_truth_has_no_loss_but_its_reconstruction() -> None:
    _, target = _faces()
    truth = NetworkOutput(target.normal, target.albedo, target.light)
    image = torch.from_numpy(f_render(*(t.numpy() for t in truth))).float()
    terms = sfsnet_loss(truth, target._replace(image=image))
    assert [t.item() for t in (terms.normal, terms.albedo, terms.light)] == [0, 0, 0]
    assert terms.recon.item() < 1e-6


@pytest.mark.parametrize("backend", ["drjit", "torch"])
def test_gradients_reach_all_three_heads_and_nothing_else(backend: Backend) -> None:
    prediction, target = _faces()
    target = FaceBatch(*(t.requires_grad_() for t in target))
    torch.autograd.backward(sfsnet_loss(prediction, target, backend=backend).total)
    assert all(t.grad is not None and t.grad.any() for t in prediction)
    assert all(t.grad is None for t in target)


def test_backends_agree_on_the_total_and_its_gradients() -> None:
    found: list[tuple[LossTerms, NetworkOutput]] = []
    for backend in ("drjit", "torch"):
        prediction, target = _faces(seed=1, size=64)
        terms = sfsnet_loss(prediction, target, backend="drjit" if backend == "drjit" else "torch")
        torch.autograd.backward(terms.total)
        found.append((terms, prediction))
    (a, first), (b, second) = found
    assert a.total.item() == pytest.approx(b.total.item(), rel=1e-6)
    for x, y in zip(first, second, strict=True):
        assert x.grad is not None
        assert y.grad is not None
        assert float((x.grad - y.grad).abs().max() / y.grad.abs().max()) < 2e-6  # worst of ten seeds 4e-7


def test_bfloat16_predictions_give_float32_terms() -> None:
    prediction, target = _faces()
    half = NetworkOutput(*(t.detach().bfloat16() for t in prediction))
    assert all(t.dtype == torch.float32 for t in sfsnet_loss(half, target))


def test_empty_mask_leaves_the_light_only() -> None:
    prediction, target = _faces()
    terms = sfsnet_loss(prediction, target._replace(mask=torch.zeros_like(target.mask)))
    assert (terms.recon.item(), terms.normal.item(), terms.albedo.item()) == (0, 0, 0)
    assert terms.total.item() == pytest.approx(0.1 * terms.light.item())


def test_masked_l1_counts_channels() -> None:
    value = masked_l1(torch.ones(1, 3, 2, 2), torch.zeros(1, 3, 2, 2), torch.tensor([[[[1.0, 0], [0, 1]]]]))
    assert value.item() == 1


def test_bad_shapes_are_named() -> None:
    prediction, target = _faces()
    with pytest.raises(InputError, match=r"prediction\.light: shape \(2, 12\)"):
        sfsnet_loss(prediction._replace(light=prediction.light[:, :12]), target)
    with pytest.raises(InputError, match=r"prediction\.normal: shape \(1, 3, 6, 6\)"):
        sfsnet_loss(prediction._replace(normal=prediction.normal[:1]), target)
    with pytest.raises(InputError, match="mask: shape"):
        sfsnet_loss(prediction, target._replace(mask=target.mask[:, 0]))
    trust = LabelConfidence(target.mask, torch.ones(2))
    with pytest.raises(InputError, match=r"trust\.pixels: shape"):
        sfsnet_loss(prediction, target, trust=trust._replace(pixels=target.mask[:1]))
    with pytest.raises(InputError, match=r"trust\.light: shape"):
        sfsnet_loss(prediction, target, trust=trust._replace(light=torch.ones(1)))


def test_a_light_counts_less_from_a_mean_square_of_one_on_and_only_where_scale_is_free() -> None:
    squares = torch.tensor([0.25, 0.9, 1.0, 1.6, 4.0, 4.0])
    light = squares.sqrt()[:, None].expand(6, 27)
    free = torch.tensor([True, True, True, True, True, False])
    faces = FaceBatch(*(torch.zeros(6, 1, 1, 1) for _ in range(5)))
    real = RealBatch(faces, torch.ones(6, 1, 1, 1), free, torch.full((6,), 0.5))
    torch.testing.assert_close(
        light_confidence(light, real), torch.tensor([0.5, 0.5, 0.5, 0.3125, 0.125, 0.5])
    )
