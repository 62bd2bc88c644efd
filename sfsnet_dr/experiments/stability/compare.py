"""One form against one case: errors in units in the last place, and the verdict."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from sfsnet_dr.core.conventions import NORMAL_EPSILON
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.experiments.stability.backends import DIFFERENTIABLE, ComputeBackend, Inputs
from sfsnet_dr.experiments.stability.cases import Bound, Case, ExpectedError, ExpectedNonFinite
from sfsnet_dr.experiments.stability.expected import expected_image, expected_loss

Array = npt.NDArray[np.float64]

#: Precisions of the inputs; results and gradients are always judged in their own.
DTYPES: Final = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float64": torch.float64}

_NEAR_THE_KINK: Final = 1e-5  # relative, of the squared length of a normal
_SLACK: Final = 5 * _NEAR_THE_KINK  # of the scale: what derivatives change by over that distance


@dataclass(frozen=True)
class Outcome:
    """What came of one form, case and precision.

    Attributes:
        form, group, case, dtype: what was judged.
        value_ulp, gradient_ulp: worst error beyond the floor, in units in the last place of the scale.
        value_rel, gradient_rel: worst error over the largest entry.
        problem: why it failed; empty where it passed.
        refused: the line of the error, where one was expected.
    """

    form: str
    group: str
    case: str
    dtype: str
    value_ulp: float = 0.0
    value_rel: float = 0.0
    gradient_ulp: float = 0.0
    gradient_rel: float = 0.0
    problem: str = ""
    refused: str = ""


class _Answer(NamedTuple):
    """What is right: the value, the gradients of the leaves, and their scales, see ``truth``."""

    value: Array
    scale: Array
    grads: list[Array]
    grad_scales: list[Array]


class _Error(NamedTuple):
    """The worst error of one array."""

    ulp: float = 0.0
    relative: float = 0.0
    problem: str = ""

    def complaint(self, what: str, allowed: float) -> str:
        """What to say of it, nothing where it is within bounds."""
        if self.problem:
            return f"{what}: {self.problem}"
        return f"{what}: off by {self.ulp:.3g} ulp, {allowed:g} allowed" if self.ulp > allowed else ""


def compare_with_expected(form: ComputeBackend, case: Case, dtype: str) -> Outcome:
    """Run a form on a case, twice, and compare with the truth. It never raises for what the form does."""
    seed = zlib.crc32(case.name.encode())
    leaves = {
        name: torch.tensor(values).to(DTYPES[dtype]).requires_grad_(name not in ("image", "mask"))
        for name, values in case.leaves(np.random.default_rng(seed)).items()
    }
    nothing = Outcome(form.name, case.group, case.name, dtype)
    try:
        first, second = _run(form, case, leaves), _run(form, case, leaves)
    except InputError as error:
        expected = isinstance(case.expect, ExpectedError) and case.expect.words in str(error)
        return replace(nothing, refused=str(error), problem="" if expected else f"refused: {error}")
    except Exception as error:  # whatever a form raises belongs into its row
        return replace(nothing, problem=f"{type(error).__name__}: {error}")
    if isinstance(case.expect, ExpectedError):
        return replace(nothing, problem="accepted, a InputError is expected")
    if list(map(_bits, first)) != list(map(_bits, second)):
        return replace(nothing, problem="a second run gives other bits")
    with np.errstate(all="ignore"):
        return _compare(form, case, leaves, first, nothing)


def _run(form: ComputeBackend, case: Case, leaves: dict[str, Tensor]) -> list[Tensor]:
    """Value and gradients of all leaves that get them."""
    with form.flags():
        value = form.call(case.build(leaves))
        if not form.differentiable:
            return [value]
        # At order 0 torch's form does not look at the normals: None there, a gradient of 0 in the others.
        wanted = _differentiated(leaves)
        grads = torch.autograd.grad(value, wanted, _weights(value), materialize_grads=True)
    return [value.detach(), *grads]


def _differentiated(leaves: dict[str, Tensor]) -> list[Tensor]:
    return [leaf for leaf in leaves.values() if leaf.requires_grad]


def _weights(value: Tensor) -> Tensor:
    """What arrives from behind: plus or minus 1/2 to 3/2 for an image, 1 for the loss."""
    rng = np.random.default_rng(0)
    shape = tuple(value.shape)
    if not shape:
        return torch.ones_like(value)
    weights = rng.uniform(0.5, 1.5, shape) * rng.choice([-1.0, 1.0], shape)
    return torch.tensor(weights, dtype=torch.float32).to(value.dtype)


def _bits(tensor: Tensor) -> bytes:
    return tensor.detach().reshape(-1).contiguous().view(torch.uint8).numpy().tobytes()


def _compare(
    form: ComputeBackend, case: Case, leaves: dict[str, Tensor], found: list[Tensor], nothing: Outcome
) -> Outcome:
    bound = case.expect if isinstance(case.expect, Bound) else Bound()
    answers = [_answer(form, case, leaves, found[0], epsilon) for epsilon in _epsilons(bound)]
    value = _error(found[0], [a.value for a in answers], answers[0].scale, bound.floor)
    problems = [value.complaint("value", bound.value)]
    errors = []
    # One number that is not finite says enough: the loss's gradients need not say it again.
    judged = [] if isinstance(case.expect, ExpectedNonFinite) and form.kind == "loss" else found[1:]
    names = [name for name, leaf in leaves.items() if leaf.requires_grad]
    for index, grad in enumerate(judged):
        scale = answers[0].grad_scales[index]
        exact = [-scale, scale] if bound.kink == "residual" else [a.grads[index] for a in answers]
        if bound.kink == "length":  # both sides were taken a little off the kink
            exact = [grad + side * _SLACK * scale for grad in exact for side in (-1, 1)]
        errors.append(_error(grad, exact, scale, bound.gradient_floor))
        problems.append(errors[-1].complaint(f"gradient of {names[index]}", bound.gradient))
    return replace(
        nothing,
        value_ulp=value.ulp,
        value_rel=value.relative,
        gradient_ulp=max((e.ulp for e in errors), default=0.0),
        gradient_rel=max((e.relative for e in errors), default=0.0),
        problem="; ".join(p for p in problems if p),
    )


def _epsilons(bound: Bound) -> list[float]:
    if bound.kink != "length":
        return [NORMAL_EPSILON]
    return [NORMAL_EPSILON * (1 + side * _NEAR_THE_KINK) for side in (-1, 1)]


def _answer(
    form: ComputeBackend, case: Case, leaves: dict[str, Tensor], value: Tensor, epsilon: float
) -> _Answer:
    copies = [
        {name: leaf.detach().double().requires_grad_(leaf.requires_grad) for name, leaf in leaves.items()}
        for _ in range(2)
    ]
    arguments = [_expanded(case.build(copy)) for copy in copies]
    normal, albedo, light, image, mask = (t.detach().numpy() for t in arguments[0])
    if form.kind == "loss":
        truth = expected_loss(normal, albedo, light, image, mask, epsilon)
    else:
        weights = _weights(value).double().numpy()
        # The form without gradients is NumPy's, the one that evaluates the basis by recurrence.
        by_polynomials = not form.differentiable
        truth = expected_image(normal, albedo, light, weights, epsilon, polynomials=by_polynomials)
    grads, scales = (
        _at_leaves(copy, inputs, parts)
        for copy, inputs, parts in zip(copies, arguments, (truth.grads, truth.grad_scales), strict=True)
    )
    return _Answer(truth.value, truth.scale, grads, scales)


def _expanded(inputs: Inputs) -> Inputs:
    batch = max(t.shape[0] for t in inputs)
    return Inputs(*(t.expand(batch, *t.shape[1:]) for t in inputs))


def _at_leaves(leaves: dict[str, Tensor], inputs: Inputs, parts: tuple[Array, ...]) -> list[Array]:
    """Gradients of the arguments carried back through the views."""
    arguments = [getattr(inputs, name) for name in DIFFERENTIABLE]
    grads = [torch.from_numpy(np.ascontiguousarray(part)) for part in parts]
    carried = torch.autograd.grad(arguments, _differentiated(leaves), grads)
    return [grad.numpy() for grad in carried]


def _error(found: Tensor, exact: list[Array], scale: Array, floor: float) -> _Error:
    """Worst error outside the range of ``exact``, and what is not finite wrongly."""
    got = found.detach().double().numpy()
    low, high = np.minimum.reduce(exact), np.maximum.reduce(exact)
    finite = np.isfinite(low) & np.isfinite(high)
    if got.shape != low.shape:
        return _Error(problem=f"shape {got.shape}, {low.shape} expected")
    hidden, spread = np.isfinite(got) & ~finite, finite & ~np.isfinite(got)
    if hidden.any() or spread.any():
        return _Error(
            problem=f"{hidden.sum()} numbers hide a NaN or inf, {spread.sum()} should be finite and are not"
        )
    error = np.where(finite, np.maximum(np.maximum(low - got, got - high), 0), 0)
    units = np.where(finite, np.maximum(error - floor, 0) / _ulp(scale, found.dtype), 0)
    largest = np.max(np.abs(np.where(finite, high, 0)), initial=0)
    relative = float(error.max(initial=0) / largest) if largest else 0.0
    return _Error(float(units.max(initial=0)), relative)


def _ulp(scale: Array, dtype: torch.dtype) -> Array:
    """Distance of neighbouring numbers of a type at a magnitude."""
    info = torch.finfo(dtype)
    magnitude = np.clip(np.nan_to_num(scale, nan=np.inf), info.tiny, info.max)
    return np.asarray(info.eps * 2.0 ** np.floor(np.log2(magnitude)))
