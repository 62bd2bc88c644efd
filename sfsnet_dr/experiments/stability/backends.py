"""What is put to the test: every SH renderer and every backend of the loss, called the same way."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, NamedTuple, get_args

import numpy as np
import torch
from torch import Tensor

from sfsnet_dr.core.errors import InputError, nearest
from sfsnet_dr.losses.reconstruction import Backend, reconstruction_l1
from sfsnet_dr.render import shading_drjit, shading_drjit_reference, shading_numpy, shading_torch
from sfsnet_dr.scene.jit import dr

#: The arguments that get gradients.
DIFFERENTIABLE: Final = ("normal", "albedo", "light")


class Inputs(NamedTuple):
    """The arguments of the loss; a renderer takes the first three. Shapes as ``reconstruction_l1``."""

    normal: Tensor
    albedo: Tensor
    light: Tensor
    image: Tensor
    mask: Tensor


@dataclass(frozen=True)
class ComputeBackend:
    """One renderer, or the loss with one backend.

    Attributes:
        name: a short word for tables, such as ``loss drjit``.
        kind: whether it gives an image or the loss.
        call: the form itself.
        differentiable: whether it gives gradients.
        jit: whether Dr.Jit computes it.
        fast_math: state of Dr.Jit's FastMath flag, on by default there.
    """

    name: str
    kind: Literal["render", "loss"]
    call: Callable[[Inputs], Tensor]
    differentiable: bool = True
    jit: bool = False
    fast_math: bool = True

    def flags(self) -> AbstractContextManager[Any]:
        """What forward and backward passes must stand in."""
        if not self.jit:
            return nullcontext()
        return dr.scoped_set_flag(dr.JitFlag.FastMath, self.fast_math)  # type: ignore[no-any-return]


def _numpy(inputs: Inputs) -> Tensor:
    # NumPy has no bfloat16; every bfloat16 is a float32. Strides go through as they are.
    arrays = [(t.float() if t.dtype == torch.bfloat16 else t).detach().numpy() for t in inputs[:3]]
    with np.errstate(all="ignore"):  # it warns of NaN and inf, which some cases are about
        return torch.from_numpy(shading_numpy.f_render(*arrays))


def _loss(backend: Backend) -> Callable[[Inputs], Tensor]:
    return lambda inputs: reconstruction_l1(*inputs, backend=backend)


#: A backend that is added to ``Backend`` joins by itself; all but ``torch`` are taken to run on Dr.Jit.
FORMS: Final = (
    ComputeBackend("numpy", "render", _numpy, differentiable=False),
    ComputeBackend("torch", "render", lambda inputs: shading_torch.f_render(*inputs[:3])),
    ComputeBackend("drjit", "render", lambda inputs: shading_drjit.f_render(*inputs[:3]), jit=True),
    ComputeBackend(
        "drjit-plain", "render", lambda inputs: shading_drjit_reference.f_render(*inputs[:3]), jit=True
    ),
    *(ComputeBackend(f"loss {b}", "loss", _loss(b), jit=b != "torch") for b in reversed(get_args(Backend))),
)

#: The same once more with FastMath off, where Dr.Jit computes.
STRICT_FORMS: Final = tuple(
    replace(form, name=f"{form.name}, FastMath off", fast_math=False) for form in FORMS if form.jit
)


def find_backend(name: str) -> ComputeBackend:
    """The form of that name.

    Raises:
        InputError: if there is none.
    """
    for form in (*FORMS, *STRICT_FORMS):
        if form.name == name:
            return form
    raise InputError(f"form {name!r}: not known; {nearest(name, [form.name for form in FORMS])}")
