"""All renderers by name: our own, and those that other packages offer as entry points.

A package joins with a class or function that takes nothing and gives a ``render.renderer.Renderer``::

    [project.entry-points."sfsnet_dr.renderers"]
    my-renderer = "my_package:MyRenderer"

Nothing is loaded before a renderer is asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final

from sfsnet_dr.core.errors import InputError, nearest
from sfsnet_dr.render.renderers.base import Renderer

#: The group of entry points.
GROUP: Final = "sfsnet_dr.renderers"

Factory = Callable[[], Renderer]

#: Depths of the path tracers, by the end of their names: surface points after the first.
BOUNCES: Final = {"direct": 0, "bounce": 1, "path": -1}

_ORDERS: Final = range(5)


def renderers() -> dict[str, Factory]:
    """What makes each renderer, by name: our own first, then those of other packages.

    Another package's renderer with the name of an earlier one is listed as ``package:name``.
    """
    found: dict[str, Factory] = {name: partial(_make, *how) for name, how in _built_in().items()}
    for point in sorted(entry_points(group=GROUP), key=lambda point: (point.name, point.value)):
        found[_free_name(point, found)] = partial(_load, point)
    return found


def is_built_in(name: str) -> bool:
    """Whether a renderer is our own, and need not be guarded against."""
    return name in _built_in()


def find_renderer(name: str) -> Renderer:
    """Load a renderer by its name.

    Args:
        name: of ours, such as ``"drjit-order2"`` or ``"mitsuba-llvm-path"``, or of another package's entry
            point in the group ``sfsnet_dr.renderers``; ``renderers()`` has all names.

    Returns:
        An object with ``name``, ``capabilities`` and ``render(subject, light, budget)``, which gives a linear
        image (H, W, 3).

    Raises:
        InputError: for an unknown name, with the nearest known one.
        NotInstalled: if the renderer needs an optional package that is missing, with the command.

    Example:
        >>> import sfsnet_dr as sf
        >>> from sfsnet_dr.render.renderers.base import Budget
        >>> renderer = sf.find_renderer("numpy-order2")
        >>> light = sf.Light.from_environment(1.0)
        >>> renderer.render(sf.build_subject("sphere"), light, Budget()).shape
        (128, 128, 3)
    """
    known = renderers()
    if name not in known:
        raise InputError(f"renderer {name!r}: unknown; {nearest(name, known)}")
    return known[name]()


def _built_in() -> dict[str, tuple[Any, ...]]:
    """Module, class or function, and arguments of our own renderers."""
    sh, path = "sfsnet_dr.render.renderers.sh", "sfsnet_dr.render.renderers.mitsuba"
    others = "sfsnet_dr.render.renderers.remote"
    shading = {
        f"{backend}-order{order}": (sh, "ShadingRenderer", backend, order)
        for backend in ("numpy", "torch", "drjit")
        for order in _ORDERS
    }
    transport = {
        f"{backend}-order{order}-{kind}": (sh, "TransportRenderer", backend, order, kind)
        for backend in ("numpy", "drjit")
        for order in (2, 4)
        for kind in ("visibility", "bounce")
    }
    mitsuba = {
        f"mitsuba-llvm-{word}": (path, "MitsubaRenderer", f"mitsuba-llvm-{word}", bounces)
        for word, bounces in BOUNCES.items()
    }
    remote = {
        f"{tracer}-{word}": (others, "make_remote", tracer, word, bounces)
        for tracer in ("mitsuba-scalar", "mitsuba-spectral", "cycles")
        for word, bounces in BOUNCES.items()
    }
    return {**shading, **transport, **mitsuba, **remote}


def _make(module: str, name: str, *arguments: Any) -> Renderer:
    made: Renderer = getattr(import_module(module), name)(*arguments)
    return made


def _load(point: EntryPoint) -> Renderer:
    made: Renderer = point.load()()
    return made


def _free_name(point: EntryPoint, taken: dict[str, Factory]) -> str:
    return f"{point.value.split('.')[0].split(':')[0]}:{point.name}" if point.name in taken else point.name
