"""The reconstruction loss: the NumPy oracle and finite differences first, then backend against backend."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import Tensor, nn

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.losses.reconstruction import BACKENDS, Backend, reconstruction_l1
from sfsnet_dr.render import shading_numpy

Array = npt.NDArray[np.float64]


def _scene(batch: int, height: int, width: int, seed: int, order: int = 2) -> list[Array]:
    """Normals of lengths 0.5 to 2, albedo, light, image, and a mask with whole and fractional weights."""
    rng = np.random.default_rng(seed)
    shape = (batch, 3, height, width)
    normal = rng.standard_normal(shape)
    normal *= rng.uniform(0.5, 2, (batch, 1, height, width)) / np.linalg.norm(normal, axis=1, keepdims=True)
    mask = np.clip(rng.uniform(-1, 2, (batch, 1, height, width)), 0, 1)
    light = rng.standard_normal((batch, 3 * (order + 1) ** 2))
    return [normal, rng.uniform(0.1, 1, shape), light, rng.uniform(size=shape), mask]


def _oracle(normal: Array, albedo: Array, light: Array, image: Array, mask: Array) -> float:
    rendered = shading_numpy.f_render(normal, albedo, light)
    return float((mask * np.abs(image - rendered)).sum() / max(3 * mask.sum(), 1))


def _tensors(arrays: list[Array], dtype: torch.dtype) -> list[Tensor]:
    return [torch.tensor(a, dtype=dtype, requires_grad=i < 3) for i, a in enumerate(arrays)]


def _loss_and_gradients(
    arrays: list[Array], dtype: torch.dtype, backend: Backend
) -> tuple[float, list[Array]]:
    tensors = _tensors(arrays, dtype)
    loss = reconstruction_l1(*tensors, backend=backend)
    assert loss.dtype == dtype
    assert loss.shape == ()
    torch.autograd.backward(loss)
    return loss.item(), [t.grad.double().numpy() for t in tensors[:3] if t.grad is not None]


def _worst(found: list[Array], expected: list[Array]) -> float:
    pairs = zip(found, expected, strict=True)
    return max(float(np.abs(f - e).max() / np.abs(e).max()) for f, e in pairs)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("order", [1, 2, 4])
def test_value_and_gradients_against_the_oracle(backend: Backend, order: int) -> None:
    arrays = _scene(2, 3, 4, seed=order, order=order)
    # No residual lies so near 0 that the finite difference would step over the kink of |x|.
    assert np.abs(arrays[3] - shading_numpy.f_render(*arrays[:3])).min() > 1e-3
    expected = []
    for values in arrays[:3]:
        grad = np.zeros_like(values)
        for at in np.ndindex(values.shape):
            kept, step = values[at], 1e-5
            values[at] = kept + step
            above = _oracle(*arrays)
            values[at] = kept - step
            grad[at] = (above - _oracle(*arrays)) / (2 * step)
            values[at] = kept
        expected.append(grad)
    value, grads = _loss_and_gradients(arrays, torch.float64, backend)
    assert value == pytest.approx(_oracle(*arrays), rel=1e-14)
    # Worst of 24 scenes 1.1e-9: the step of the finite difference.
    assert _worst(grads, expected) < 1e-8
    value, grads = _loss_and_gradients(arrays, torch.float32, backend)
    assert value == pytest.approx(_oracle(*arrays), rel=1e-6)
    # Worst of 24 scenes 1.2e-6 and, for the value, 2.1e-7: float32 round-off.
    assert _worst(grads, expected) < 6e-6


@pytest.mark.parametrize("seed", range(3))
def test_backends_agree_in_float32_at_working_size(seed: int) -> None:
    arrays = _scene(4, 128, 128, seed)
    exact_value, exact = _loss_and_gradients(arrays, torch.float64, "torch")
    values, grads = zip(*(_loss_and_gradients(arrays, torch.float32, b) for b in BACKENDS), strict=True)
    # Worst of 20 seeds: values 2.9e-7 (drjit) and 1.3e-7 (torch); gradients 6.1e-7 and 4.7e-7 from float64,
    # 5.9e-7 from each other.
    assert values == pytest.approx([exact_value] * len(BACKENDS), rel=1.5e-6)
    for found in grads:
        assert _worst(found, exact) < 2e-6
    assert all(_worst(found, grads[-1]) < 2e-6 for found in grads[:-1])


@pytest.mark.parametrize("backend", BACKENDS)
def test_slope_of_the_absolute_value_at_zero_is_zero(backend: Backend) -> None:
    """Black albedo and a black image leave residuals of exactly 0, and albedo would move them."""
    normal, albedo, light, image, mask = _tensors(_scene(1, 4, 4, seed=0), torch.float32)
    black = torch.zeros_like(albedo, requires_grad=True)
    loss = reconstruction_l1(normal, black, light, torch.zeros_like(image), mask, backend=backend)
    torch.autograd.backward(loss)
    assert loss.item() == 0
    assert black.grad is not None
    assert not black.grad.any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_masked_pixels_count_for_nothing(backend: Backend) -> None:
    arrays = _scene(2, 5, 6, seed=1)
    arrays[4] = (arrays[4] > 0.5).astype(np.float64)
    outside = np.broadcast_to(arrays[4] == 0, arrays[0].shape)
    value, grads = _loss_and_gradients(arrays, torch.float64, backend)
    assert not grads[0][outside].any()
    assert not grads[1][outside].any()
    assert grads[1][~outside].all()
    arrays[3][outside] += 100
    assert _loss_and_gradients(arrays, torch.float64, backend)[0] == value


@pytest.mark.parametrize("backend", BACKENDS)
def test_empty_mask_gives_zero(backend: Backend) -> None:
    arrays = _scene(2, 5, 6, seed=1)
    arrays[4][:] = 0
    value, grads = _loss_and_gradients(arrays, torch.float32, backend)
    assert value == 0
    assert not any(g.any() for g in grads)


@pytest.mark.parametrize("backend", BACKENDS)
def test_value_does_not_depend_on_size(backend: Backend) -> None:
    """A mean, not a sum: the same face four times over has the same loss."""
    arrays = _scene(1, 4, 4, seed=2)
    tiled = [np.tile(a, (2, 1, 2, 2)) if a.ndim == 4 else np.repeat(a, 2, axis=0) for a in arrays]
    one, eight = (_loss_and_gradients(a, torch.float64, backend)[0] for a in (arrays, tiled))
    assert eight == pytest.approx(one, rel=1e-14)


@pytest.mark.parametrize("backend", BACKENDS)
def test_image_and_mask_get_no_gradient(backend: Backend) -> None:
    tensors = [nn.Parameter(t.detach()) for t in _tensors(_scene(1, 4, 4, seed=3), torch.float32)]
    torch.autograd.backward(reconstruction_l1(*tensors, backend=backend))
    assert [t.grad is not None for t in tensors] == [True, True, True, False, False]


@pytest.mark.parametrize("backend", BACKENDS)
def test_broadcast_light(backend: Backend) -> None:
    """One light for the whole batch collects the gradients of all images."""
    arrays = _scene(3, 4, 5, seed=4)
    arrays[2][:] = arrays[2][:1]
    _, full = _loss_and_gradients(arrays, torch.float64, backend)
    arrays[2] = arrays[2][:1]
    _, single = _loss_and_gradients(arrays, torch.float64, backend)
    np.testing.assert_allclose(single[2], full[2].sum(axis=0, keepdims=True), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("which", range(5))
def test_nan_is_not_swallowed(backend: Backend, which: int) -> None:
    tensors = [t.detach() for t in _tensors(_scene(1, 4, 4, seed=5), torch.float32)]
    tensors[which].view(-1)[3] = torch.nan
    assert reconstruction_l1(*tensors, backend=backend).isnan()


@pytest.mark.parametrize("backend", BACKENDS)
def test_half_precision_is_raised(backend: Backend) -> None:
    arrays = _scene(1, 4, 4, seed=6)
    tensors = [
        t.detach().bfloat16().requires_grad_(i < 3) for i, t in enumerate(_tensors(arrays, torch.float32))
    ]
    loss = reconstruction_l1(*tensors, backend=backend)
    assert loss.dtype == torch.float32
    assert loss.item() == pytest.approx(_oracle(*(t.detach().double().numpy() for t in tensors)), rel=1e-6)
    torch.autograd.backward(loss)
    assert all(t.grad is not None and t.grad.dtype == torch.bfloat16 for t in tensors[:3])


@pytest.mark.parametrize("backend", BACKENDS)
def test_autocast_does_not_round_the_loss(backend: Backend) -> None:
    arrays = _scene(2, 8, 8, seed=6)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        value, _ = _loss_and_gradients(arrays, torch.float32, backend)
    assert value == _loss_and_gradients(arrays, torch.float32, backend)[0]


def test_same_bits_in_every_run() -> None:
    """An exact resume of a training needs it, also where pixels are no multiple of a thread's share."""
    arrays = _scene(5, 100, 100, seed=7)
    value, grads = _loss_and_gradients(arrays, torch.float32, "drjit")
    for _ in range(10):
        again, others = _loss_and_gradients(arrays, torch.float32, "drjit")
        assert again == value
        assert all(np.array_equal(a, b) for a, b in zip(grads, others, strict=True))


def test_second_derivatives() -> None:
    """Refused by the Dr.Jit form; the torch form has them."""
    normal, albedo, light, image, mask = _tensors(_scene(1, 3, 3, seed=8), torch.float64)
    with pytest.raises(RuntimeError, match="first-order derivatives only"):
        torch.autograd.grad(reconstruction_l1(normal, albedo, light, image, mask), light, create_graph=True)
    loss = reconstruction_l1(normal, albedo, light, image, mask, backend="torch")
    (first,) = torch.autograd.grad(loss, light, create_graph=True)
    assert torch.autograd.grad(first.square().sum(), albedo)[0].any()


def test_bad_input_is_named() -> None:
    good = [t.detach() for t in _tensors(_scene(2, 4, 5, seed=9), torch.float32)]
    normal, albedo, light, image, mask = good
    with pytest.raises(InputError, match="mask: shape"):
        reconstruction_l1(normal, albedo, light, image, mask[:, 0])
    with pytest.raises(InputError, match="image: shape"):
        reconstruction_l1(normal, albedo, light, image[:1], mask)
    with pytest.raises(InputError, match="light: 26 coefficients"):
        reconstruction_l1(normal, albedo, light[:, :26], image, mask)
    with pytest.raises(InputError, match=r"backend: 'drjitt' found; did you mean 'drjit'"):
        reconstruction_l1(*good, backend="drjitt")  # type: ignore[arg-type]
