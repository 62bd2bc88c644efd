"""The fast loss: any memory, hard numbers and threads, held against torch in double precision."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from sfsnet_dr.losses.reconstruction import Backend, reconstruction_l1
from sfsnet_dr.render import drjit_interop
from sfsnet_dr.render.drjit_interop import PACKET, make_view

Inputs = list[Tensor]


def _inputs(batch: int = 3, height: int = 8, width: int = 16, seed: int = 0) -> Inputs:
    rng = torch.Generator().manual_seed(seed)
    shape = (batch, 3, height, width)
    normal = torch.randn(shape, generator=rng)
    albedo, image = (torch.rand(shape, generator=rng) for _ in range(2))
    mask = (torch.rand(batch, 1, height, width, generator=rng) > 0.3).float()
    return [normal, albedo, torch.randn(batch, 27, generator=rng), image, mask]


def _results(inputs: Inputs, backend: Backend, expected: float = 1, times: float = 1) -> Inputs:
    """The loss times a factor, and its gradients; inputs are leaves, in the memory that they have."""
    leaves = [t.detach().requires_grad_() for t in inputs[:3]]
    loss = times * reconstruction_l1(*leaves, *inputs[3:], backend=backend, expected_gradient=expected)
    return [loss.detach(), *torch.autograd.grad(loss, leaves)]


def _assert_right(inputs: Inputs, margin: float = 1) -> None:
    """Against torch in double precision, relative to the largest entry: float32 round-off.

    Worst of the cases here 7e-7, in the light, whose terms nearly cancel; margin 4.
    """
    exact = _results([t.double() for t in inputs], "torch")
    for found, right in zip(_results(inputs, "drjit"), exact, strict=True):
        assert found.isfinite().all()
        assert float((found - right).abs().max()) <= 3e-6 * margin * float(right.abs().max())


def _sliced(inputs: Inputs) -> Inputs:
    normal, albedo, light, image, mask = _inputs(height=10, width=20)
    cut = [t[:, :, 1:9, 2:18] for t in (normal, albedo, image, mask)]
    return [cut[0], cut[1], light.repeat(1, 2)[:, 5:32], cut[2], cut[3]]


def _rows(inputs: Inputs) -> Inputs:
    normal, albedo, light, image, mask = _inputs(height=12)
    return [normal[:, :, 4:], albedo[:, :, :8], light, image[:, :, 2:10], mask[:, :, 3:11]]


def _channels_last(inputs: Inputs) -> Inputs:
    return [t.contiguous(memory_format=torch.channels_last) if t.ndim == 4 else t for t in inputs]


def _unaligned(inputs: Inputs) -> Inputs:
    """Each tensor begins one number after what torch aligned."""
    return [torch.cat([torch.zeros(1), t.ravel()])[1:].view(t.shape) for t in inputs]


MEMORY: dict[str, Callable[[Inputs], Inputs]] = {
    "contiguous": lambda x: x,
    "channels-last": _channels_last,
    "one of them channels-last": lambda x: [_channels_last(x)[0], *x[1:]],
    "transposed": lambda x: [t.transpose(2, 3) if t.ndim == 4 else t for t in x],
    "sliced": _sliced,
    "rows left out": _rows,
    "every other image": lambda x: [t.repeat_interleave(2, 0)[::2] for t in x],
    "planes of a wider tensor": lambda x: [t.repeat(1, 2, 1, 1)[:, 1:4] for t in x[:2]] + x[2:],
    "unaligned": _unaligned,
    "one normal map": lambda x: [x[0][:1], *x[1:]],
    "one light": lambda x: [*x[:2], x[2][:1], *x[3:]],
    "one mask, expanded": lambda x: [*x[:4], x[4][:1].expand(3, 1, 8, 16)],
    "columns reversed": lambda x: [t.flip(-1) for t in x],
}


@pytest.mark.parametrize("name", MEMORY)
def test_any_memory(name: str) -> None:
    _assert_right(MEMORY[name](_inputs()))


@pytest.mark.parametrize("size", [(1, 1, 1), (2, 1, 8), (2, 3, 5), (1, 40, 40), (2, 7, 9), (40, 8, 8)])
def test_any_size(size: tuple[int, int, int]) -> None:
    """Whole packets or not, runs that end within a group of lanes, one pixel."""
    _assert_right(_inputs(*size))


def test_gradients_keep_the_layout() -> None:
    inputs = _channels_last(_inputs())
    _, normal, albedo, _ = _results(inputs, "drjit")
    assert normal.is_contiguous(memory_format=torch.channels_last)
    assert albedo.is_contiguous(memory_format=torch.channels_last)


@pytest.mark.parametrize("name", ["contiguous", "channels-last", "every other image", "rows left out"])
def test_memory_is_shared_where_it_fits(name: str) -> None:
    for tensor in MEMORY[name](_inputs()):
        if tensor.ndim == 4 and tensor.data_ptr() % 64 == 0:
            assert make_view(tensor, PACKET).values.data_ptr() == tensor.data_ptr()


def test_hard_numbers() -> None:
    normal, albedo, light, image, mask = _inputs(height=16)
    normal[0, :, 0] = 0
    normal[0, :, 1] *= 1e-7
    normal[0, :, 2] *= 1e-25
    normal[0, :, 3] *= 1e20
    normal[0, :, 4] *= 1e37
    albedo[1, :, :4] = 0
    image[1, :, :2] = 0  # residuals of exactly 0
    mask[2] = 0
    _assert_right([normal, albedo, light, image, mask])
    of_albedo = _results([normal, albedo, light, image, mask], "drjit")[2]
    assert not of_albedo[1, :, :2].any()
    assert not of_albedo[2].any()


def test_twins_agree() -> None:
    inputs = _inputs(seed=1)
    for fast, plain in zip(_results(inputs, "drjit"), _results(inputs, "drjit-plain"), strict=True):
        torch.testing.assert_close(fast, plain, rtol=0, atol=3e-6 * float(plain.abs().max()))


@pytest.mark.parametrize("expected", [1.0, 0.5, 0.3, 0.0])
def test_results_do_not_depend_on_the_expected_gradient(expected: float) -> None:
    inputs = _inputs()
    exact = _results([t.double() for t in inputs], "torch", times=0.3)
    for found, right in zip(_results(inputs, "drjit", expected, times=0.3), exact, strict=True):
        assert float((found - right).abs().max()) <= 3e-6 * float(right.abs().max())


def test_backward_twice_over_a_kept_graph() -> None:
    inputs = _inputs()
    leaves = [t.requires_grad_() for t in inputs[:3]]
    loss = reconstruction_l1(*leaves, *inputs[3:])
    first = torch.autograd.grad(loss, leaves, torch.tensor(2.0), retain_graph=True)
    kept = [t.clone() for t in first]
    second = torch.autograd.grad(loss, leaves, torch.tensor(2.0))
    assert all(torch.equal(a, b) for a, b in zip(kept, second, strict=True))
    assert all(torch.equal(a, b) for a, b in zip(kept, first, strict=True))


def test_calls_without_gradients_have_the_same_value() -> None:
    inputs = _inputs()
    with torch.no_grad():
        value = reconstruction_l1(*inputs)
    assert not value.requires_grad
    torch.testing.assert_close(value, _results(inputs, "drjit")[0], rtol=1e-6, atol=0)


def test_kernels_are_compiled_once() -> None:
    """Another batch size, light or image size in whole packets needs no new kernel."""
    _results(_inputs(), "drjit")
    compiled = drjit_interop.kernels_compiled(
        lambda: [_results(_inputs(b, h, 16, seed=b), "drjit") for b, h in ((3, 8), (2, 8), (5, 8), (2, 24))]
    )
    assert compiled == 0
    assert drjit_interop.kernels_compiled(lambda: _results(_inputs(2, 3, 7), "drjit")) in (0, 1)


def test_several_threads_at_once() -> None:
    scenes = [_inputs(batch=1 + s, seed=s) for s in range(4)]
    right = [_results(scene, "drjit") for scene in scenes]
    wrong: list[int] = []

    def work(index: int) -> None:
        for _ in range(10):
            found = _results(scenes[index], "drjit")
            if not all(torch.equal(a, b) for a, b in zip(found, right[index], strict=True)):
                wrong.append(index)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
        assert not thread.is_alive()
    assert not wrong


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_on_a_cuda_device() -> None:
    inputs = _inputs()
    found = _results([t.cuda() for t in inputs], "drjit")
    assert all(t.device.type == "cuda" for t in found)
    for a, b in zip(found, _results([t.double() for t in inputs], "torch"), strict=True):
        assert float((a.cpu() - b).abs().max()) <= 3e-6 * float(b.abs().max())


def test_one_tensor_given_twice_before_and_after_two() -> None:
    """Dr.Jit replays a recording by the addresses of its inputs, so this could mix tensors up."""
    inputs = _inputs(batch=2, height=4, width=6, seed=3)
    twice = [inputs[0], inputs[0], inputs[2], inputs[0].abs(), inputs[4]]
    for case in (twice, inputs, twice, inputs):
        _assert_right(case)


def test_batches_of_one_in_turns() -> None:
    """Structures that differ in their steps alone must not replay each other's recordings."""
    full = _inputs(batch=3, height=5, width=7)
    for which in ((0,), (1,), (2,), (0, 1), (1, 2), (0, 2), ()) * 2:
        _assert_right([t[:1] if i in which else t for i, t in enumerate(full)])
