"""Other processes, and sizes beyond 32-bit indices: what can hang or end a process."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable
from typing import Any, Final

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.experiments.stability.process_case import Finding, ProcessCase

_PATIENCE: Final = 100  # seconds for another process, generous: only a hang takes so long


def _fork_before(name: str) -> Finding:
    """The parent starts torch and Dr.Jit only after it has forked; both work at the same time."""
    child = _forked(lambda: _digest(name))
    here = _digest(name)
    return _same([_read(child), here])


def _fork_after(name: str) -> Finding:
    _digest(name)  # starts all threads
    expected = _alone(lambda: _digest(name))
    return _same_or_refused(name, expected, _read(_forked(lambda: _alone(lambda: _digest(name)))))


def _fork_between(name: str) -> Finding:
    """The graph is made before the fork, the backward pass is asked for after it."""
    from sfsnet_dr.experiments.stability.backends import find_backend
    from sfsnet_dr.experiments.stability.workload import float_bits, make_inputs, run_backward, run_forward

    form, arguments = find_backend(name), make_inputs(0, 2, 256, 256)
    total = run_forward(form, arguments)
    run_backward(form, run_forward(form, arguments), arguments)  # starts all threads
    expected = _alone(lambda: float_bits(total, *run_backward(form, run_forward(form, arguments), arguments)))
    child = _forked(lambda: _alone(lambda: float_bits(total, *run_backward(form, total, arguments))))
    return _same_or_refused(name, expected, _read(child))


def _spawn(name: str) -> Finding:
    expected = _digest(name)
    context = multiprocessing.get_context("spawn")
    with context.Pool(1) as pool:
        return _same([expected, pool.apply_async(_digest, (name,)).get(timeout=_PATIENCE)])


def _expanded(name: str) -> Finding:
    """1.5 times 2^31 numbers in views of one pixel: computing them would take 12 GB and more."""
    import torch

    from sfsnet_dr.experiments.stability.backends import Inputs, find_backend

    images = torch.ones(1, 3, 1, 1).expand(1, 3, 2**15, 2**15)
    light = torch.ones(1, 27)
    try:
        find_backend(name).call(Inputs(images, images, light, images, images[:, :1]))
    except InputError as error:
        return Finding(0, refused=str(error))
    return Finding(0, "accepted, a InputError is expected")


def _far_apart(name: str) -> Finding:
    """Channels 2^30 elements apart, so that the last lies beyond 2^31; only touched pages are in memory."""
    import torch

    from sfsnet_dr.experiments.stability.backends import find_backend
    from sfsnet_dr.experiments.stability.workload import make_inputs

    form, near = find_backend(name), make_inputs(0, 1, 4, 4)
    near = near._replace(
        **{n: getattr(near, n).detach().bfloat16().requires_grad_() for n in ("normal", "albedo")}
    )
    try:
        store = torch.empty(2**31 + 64, dtype=torch.bfloat16)
    except RuntimeError:
        return Finding(0, "no 4 GB of address space")
    far = {}
    for shift, argument in ((0, "normal"), (32, "albedo")):
        view = store.as_strided((1, 3, 4, 4), (0, 2**30, 4, 1), shift)
        view.copy_(getattr(near, argument).detach())
        far[argument] = view.detach().requires_grad_()
    return _same([_bfloat16_digest(form, near), _bfloat16_digest(form, near._replace(**far))])


def _bfloat16_digest(form: Any, arguments: Any) -> str:
    from sfsnet_dr.experiments.stability.workload import float_bits, run_backward, run_forward

    total = run_forward(form, arguments)
    return float_bits(total, *(grad.float() for grad in run_backward(form, total, arguments)))


def _alone(work: Callable[[], str]) -> str:
    """Without torch's own threads, which a fork leaves behind as well; its DataLoader does the same.

    The last bits of torch's sums depend on how many threads share them.
    """
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return work()
    finally:
        torch.set_num_threads(threads)


def _digest(name: str) -> str:
    from sfsnet_dr.experiments.stability.workload import digest_of

    return digest_of(name)


def _forked(work: Callable[[], str]) -> tuple[int, int]:
    """Start a forked child; it writes what ``work`` gives, or the line of its error, into a pipe."""
    end, start = os.pipe()
    child = os.fork()
    if child:
        os.close(start)
        return child, end
    signal.alarm(_PATIENCE)
    try:
        text = work()
    except InputError as error:
        text = f"refused: {error}"
    except Exception as error:  # the parent tells it
        text = f"{type(error).__name__}: {error}"
    os.write(start, text.encode())
    os._exit(0)


def _read(child: tuple[int, int]) -> str:
    pid, end = child
    with os.fdopen(end) as pipe:
        text = pipe.read()
    _, status = os.waitpid(pid, 0)
    code = os.waitstatus_to_exitcode(status)
    if code == -signal.SIGALRM:
        return f"no answer in {_PATIENCE} s"
    return text if code == 0 else f"ended with {code}"


def _same(found: list[str]) -> Finding:
    strange = next((text for text in found if text != found[-1]), "")
    return Finding(len(found), f"other than expected: {strange}" if strange else "")


def _same_or_refused(name: str, expected: str, found: str) -> Finding:
    from sfsnet_dr.experiments.stability.backends import find_backend

    if not find_backend(name).jit:
        return _same([found, expected])
    if "process forked" in found:
        return Finding(0, refused=found.removeprefix("refused: "))
    # Gradients that the forward pass has computed already are only handed on.
    return Finding(
        2, "" if found == expected else f"a InputError or the same bits are expected, found: {found}"
    )


_THREADS_GONE: Final = (
    "a fork takes no threads along: Dr.Jit would wait for its own for ever; torch is told to use one, "
    "as its DataLoader does"
)

#: All of them, in the order of the page.
CASES: Final = (
    ProcessCase(
        "fork, then start",
        "same bits as in the parent",
        "nothing was started that could be lost",
        _fork_before,
        alone=True,
    ),
    ProcessCase("start, then fork", "Dr.Jit: InputError; others: same bits", _THREADS_GONE, _fork_after),
    ProcessCase(
        "forward, fork, backward",
        "Dr.Jit: InputError, or as others: same bits",
        _THREADS_GONE,
        _fork_between,
        differentiable_only=True,
    ),
    ProcessCase("spawn", "same bits as in the parent", "a new process starts its own threads", _spawn),
    ProcessCase(
        "more than 2^31 numbers in an expanded view", "InputError", "indices have 32 bits", _expanded
    ),
    ProcessCase(
        "more than 2^31 elements between channels",
        "same bits as packed",
        "addresses have 64 bits, and Dr.Jit gets packed copies",
        _far_apart,
    ),
)
