"""The smallest runs that show that Dr.Jit and Mitsuba work here; each is checked against a closed form.

They may end the process (an unsuitable LLVM aborts it), so they are run in a process of their own by
``sfsnet_dr.experiments.doctor``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.core import runtime
from sfsnet_dr.core.errors import RunError

_ALBEDO: Final = 0.5
#: A few float32 roundings (6e-8 each) in every number compared, times a margin of 20.
_RELATIVE: Final = 1e-5


#: What a step found: one line to read, and values by name.
Finding = tuple[str, dict[str, str | int]]


def start() -> Finding:
    """Choose libLLVM and set the variant."""
    runtime.start()
    version, threads = runtime.loaded_llvm_version(), runtime.threads()
    line = f"{runtime.DEFAULT_VARIANT}, LLVM {version}, {threads} threads"
    return line, {"llvm_loaded": version, "threads": threads}


def kernel() -> Finding:
    """Compile a kernel with reverse-mode derivatives: the gradient of sum x^3 is 3 x^2."""
    import drjit as dr
    import mitsuba as mi

    x = dr.linspace(mi.Float, 0.0, 1.0, 256)
    dr.enable_grad(x)
    dr.backward(dr.sum(x**3))
    points = np.linspace(0, 1, 256)
    _check("gradient", np.array(dr.grad(x)), 3 * points**2)
    return "compiled, and its derivative is right", {}


def render() -> Finding:
    """Render a grey wall in a uniform environment of radiance 1: every pixel shows the albedo."""
    import mitsuba as mi

    wall = {
        "type": "rectangle",
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": _ALBEDO}},
    }
    camera = {
        "type": "perspective",
        "fov": 30,
        "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 3], target=[0, 0, 0], up=[0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
    }
    scene = mi.load_dict(
        {
            "type": "scene",
            # Rays drawn in proportion to the cosine alone reach the sky with weight 1: no noise at all.
            "integrator": {"type": "direct", "bsdf_samples": 1, "emitter_samples": 0},
            "sensor": camera,
            "wall": wall,
            "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}},
        }
    )
    _check("image", np.array(mi.render(scene, spp=4)), np.full((8, 8, 3), _ALBEDO))
    return "8 x 8 pixels traced, and each is right", {}


STEPS: Final[dict[str, Callable[[], Finding]]] = {"variant": start, "kernel": kernel, "render": render}


def _check(name: str, found: NDArray[np.float32], expected: NDArray[np.float64]) -> None:
    if not np.allclose(found, expected, rtol=_RELATIVE, atol=_RELATIVE):
        worst = float(np.abs(found - expected).max())
        raise RunError(f"{name}: off by {worst:.3g}, at most {_RELATIVE:g} expected")
