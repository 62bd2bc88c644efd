"""Dr.Jit with a good LLVM: ``from sfsnet_dr.render.jit import dr``.

``import drjit`` loads whatever libLLVM it finds at once, so the choice has to be made before. Every file that
computes with Dr.Jit gets it from here; importing this file starts the runtime.
"""

from __future__ import annotations

from sfsnet_dr.base import runtime

runtime.start()

import drjit as dr  # noqa: E402

__all__ = ["dr"]
