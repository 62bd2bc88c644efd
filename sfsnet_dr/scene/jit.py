"""Dr.Jit and Mitsuba with a good LLVM: ``from sfsnet_dr.scene.jit import dr, mi``.

``import drjit`` loads whatever libLLVM it finds at once, so the choice has to be made before. Every file that
computes with Dr.Jit or Mitsuba gets them from here; importing this file starts the runtime.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sfsnet_dr.core import runtime

runtime.start()

import drjit as dr  # noqa: E402  (the variant is chosen first)
import mitsuba as mi  # noqa: E402

__all__ = ["dr", "mi", "upload_array"]

_NUMPY: dict[Any, npt.DTypeLike] = {mi.Float: np.float32, mi.UInt32: np.uint32}
_ALIGNMENT = 64  # bytes: the widest vector that Dr.Jit compiles for


def upload_array(kind: Any, array: npt.ArrayLike) -> Any:
    """A Dr.Jit array of one of Mitsuba's types, such as ``mi.Float``, with the values of a NumPy array.

    Dr.Jit maps NumPy's memory instead of copying it, and compiles one kernel for memory that is aligned and
    another for memory that is not. NumPy aligns by chance, so each face might compile its kernels again.

    Args:
        kind: a type of one dimension.
        array: of any shape; read in C order.
    """
    values: npt.NDArray[Any] = np.ravel(np.asarray(array, dtype=_NUMPY[kind]))
    memory = np.empty(values.nbytes + _ALIGNMENT, dtype=np.uint8)
    first = -memory.ctypes.data % _ALIGNMENT
    aligned = memory[first : first + values.nbytes].view(values.dtype)
    aligned[:] = values
    return kind(aligned)
