"""What can go wrong between torch and Dr.Jit: parameters, memory, threads, second derivatives, last bits."""

from __future__ import annotations

import subprocess
import sys
import threading

import pytest
import torch
from torch import Tensor, nn

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.render import shading_drjit, shading_torch
from sfsnet_dr.render.shading_drjit import f_render


def _inputs(batch: int = 2, height: int = 9, width: int = 7, seed: int = 0) -> list[Tensor]:
    rng = torch.Generator().manual_seed(seed)
    normal, albedo = (
        torch.randn(batch, 3, height, width, generator=rng),
        torch.rand(batch, 3, height, width, generator=rng),
    )
    light = torch.randn(batch, 27, generator=rng)
    return [t.requires_grad_() for t in (normal, albedo, light)]


def _gradients(inputs: list[Tensor]) -> list[Tensor]:
    return list(torch.autograd.grad(f_render(*inputs).square().sum(), inputs))


def _twin_gradients(inputs: list[Tensor]) -> list[Tensor]:
    return list(torch.autograd.grad(shading_torch.f_render(*inputs).square().sum(), inputs))


def _assert_close(found: list[Tensor], expected: list[Tensor]) -> None:
    for f, e in zip(found, expected, strict=True):
        # Float32 round-off, worst seen 7e-7 of the largest entry, times 5.
        torch.testing.assert_close(f, e, rtol=0, atol=4e-6 * float(e.abs().max()))


def test_parameters_get_gradients() -> None:
    inputs: list[Tensor] = [nn.Parameter(t.detach()) for t in _inputs()]
    torch.autograd.backward(f_render(*inputs).square().sum())
    _assert_close([p.grad for p in inputs if p.grad is not None], _twin_gradients(inputs))


def test_other_subclasses_of_tensor_are_taken() -> None:
    class Marked(Tensor):
        pass

    plain = _inputs()
    marked = [t.detach().as_subclass(Marked).requires_grad_() for t in plain]
    torch.autograd.backward(f_render(*marked).square().sum())
    _assert_close([m.grad.as_subclass(Tensor) for m in marked if m.grad is not None], _twin_gradients(plain))


def test_only_what_requires_a_gradient_gets_one() -> None:
    normal, albedo, light = _inputs()
    torch.autograd.backward(f_render(normal.detach(), albedo, light.detach()).sum())
    assert normal.grad is None
    assert light.grad is None
    torch.testing.assert_close(albedo.grad, shading_torch.shading(normal, light), rtol=0, atol=4e-6)
    assert not f_render(*(t.detach() for t in (normal, albedo, light))).requires_grad
    with torch.no_grad():
        assert not f_render(normal, albedo, light).requires_grad


@pytest.mark.parametrize("layout", ["channels_last", "transposed", "sliced"])
def test_any_memory_layout(layout: str) -> None:
    normal, albedo, light = (t.detach() for t in _inputs(height=8, width=8))
    if layout == "channels_last":
        normal, albedo = (t.contiguous(memory_format=torch.channels_last) for t in (normal, albedo))
    elif layout == "transposed":
        normal, albedo = normal.transpose(2, 3), albedo.transpose(2, 3)
    else:
        normal, albedo, light = normal[:, :, 1:, ::2], albedo[:, :, 1:, ::2], light.repeat(1, 2)[:, 27:]
    inputs = [t.requires_grad_() for t in (normal, albedo, light)]
    torch.testing.assert_close(f_render(*inputs), shading_torch.f_render(*inputs), rtol=0, atol=4e-6)
    _assert_close(_gradients(inputs), _twin_gradients(inputs))


def test_the_result_owns_its_memory() -> None:
    inputs = [t.detach() for t in _inputs()]
    image = f_render(*inputs)
    kept = image.clone()
    f_render(*(t + 1 for t in inputs))
    for t in inputs:
        t.zero_()
    assert torch.equal(image, kept)


def test_change_in_place_is_refused() -> None:
    """Dr.Jit reads the memory again in the backward pass: a changed input would give a wrong gradient."""
    leaves = _inputs()
    normal = leaves[0] * 1
    image = f_render(normal, *leaves[1:])
    with torch.no_grad():
        normal.mul_(2)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        torch.autograd.backward(image.sum())


def test_second_derivatives_are_refused() -> None:
    inputs = _inputs()
    with pytest.raises(RuntimeError, match="first-order derivatives only"):
        torch.autograd.grad(f_render(*inputs).square().sum(), inputs, create_graph=True)


def test_backward_twice_over_a_kept_graph() -> None:
    inputs = _inputs()
    total = f_render(*inputs).square().sum()
    first = torch.autograd.grad(total, inputs, retain_graph=True)
    second = torch.autograd.grad(total, inputs)
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


def test_two_results_share_inputs() -> None:
    """Gradients of two uses of one tensor add up, in whichever order the graph is walked."""
    normal, albedo, light = _inputs()
    total = f_render(normal, albedo, light).sum() + shading_drjit.shading(normal, light).square().sum()
    twin = shading_torch.f_render(normal, albedo, light).sum()
    twin = twin + shading_torch.shading(normal, light).square().sum()
    inputs = [normal, albedo, light]
    _assert_close(list(torch.autograd.grad(total, inputs)), list(torch.autograd.grad(twin, inputs)))


def test_gradient_arriving_as_a_broadcast_view() -> None:
    """``sum`` sends an expanded tensor of stride 0 backwards, ``permute`` a transposed one."""
    inputs = _inputs()
    for render in (f_render, shading_torch.f_render):
        image = render(*inputs).permute(0, 2, 3, 1)
        torch.autograd.backward((image * torch.arange(3.0)).sum())
    found = [t.grad for t in inputs]
    weight = torch.arange(3.0)[:, None, None]
    once = torch.autograd.grad((shading_torch.f_render(*inputs) * weight).sum(), inputs)
    _assert_close([g / 2 for g in found if g is not None], list(once))


def test_backward_in_another_thread() -> None:
    inputs = _inputs()
    total = f_render(*inputs).square().sum()
    found: list[list[Tensor]] = []
    thread = threading.Thread(target=lambda: found.append(list(torch.autograd.grad(total, inputs))))
    thread.start()
    thread.join(timeout=60)
    _assert_close(found[0], _twin_gradients(inputs))


def test_several_threads_at_once() -> None:
    scenes = [_inputs(seed=s) for s in range(4)]
    found: dict[int, list[Tensor]] = {}

    def work(index: int) -> None:
        for _ in range(10):
            found[index] = _gradients(scenes[index])

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
    for index, inputs in enumerate(scenes):
        _assert_close(found[index], _twin_gradients(inputs))


@pytest.mark.parametrize("size", [100, 128, 181])
def test_gradients_have_the_same_bits_in_every_run(size: int) -> None:
    """Sums over pixels whose count is no multiple of a thread's share show it when their order varies."""
    inputs = _inputs(batch=5, height=size, width=size)
    runs = [_gradients(inputs) for _ in range(12)]
    for other in runs[1:]:
        assert all(torch.equal(a, b) for a, b in zip(runs[0], other, strict=True))


def test_a_tensor_elsewhere_is_refused() -> None:
    inputs = [t.detach().to("meta") for t in _inputs()]
    with pytest.raises(InputError, match="tensor on meta found, cpu or cuda expected"):
        f_render(*inputs)


def test_a_forked_process_is_refused() -> None:
    """In a process of its own with a time limit: without the refusal a forked child waits for ever."""
    code = """
import os, signal, torch
from sfsnet_dr.render.shading_drjit import shading
normal, light = torch.randn(1, 3, 256, 256, requires_grad=True), torch.randn(1, 27)
before = shading(normal, light)
for work in (lambda: shading(normal, light), before.sum().backward):
    if os.fork() == 0:
        signal.alarm(20)
        try:
            work()
        except Exception as error:
            print(error, flush=True)
        os._exit(0)
    os.wait()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout.count("process forked after Dr.Jit had started") == 2, done
