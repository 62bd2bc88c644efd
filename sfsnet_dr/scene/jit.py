"""Dr.Jit and Mitsuba with a good LLVM: ``from sfsnet_dr.scene.jit import dr, mi``.

``import drjit`` loads whatever libLLVM it finds at once, so the choice has to be made before. Every file that
computes with Dr.Jit or Mitsuba gets them from here; importing this file starts the runtime.
"""

from __future__ import annotations

from sfsnet_dr.base import runtime

runtime.start()

import drjit as dr  # noqa: E402  (the variant is chosen first)
import mitsuba as mi  # noqa: E402

__all__ = ["dr", "mi"]
