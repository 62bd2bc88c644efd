"""The SH models as renderers: order 0 to 4 in three implementations, and with visibility or one bounce.

Names: ``torch-order2`` shades normals; ``numpy-order4-visibility`` weighs light transport, which knows cast
shadows; ``-bounce`` adds light that met one further point. Gloss is left out. Images are not clamped.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
import torch

from sfsnet_dr.render import shading_drjit, shading_numpy, shading_torch
from sfsnet_dr.render.renderer import Budget, Capabilities, Image
from sfsnet_dr.render.surface_maps import (
    bounced_transport,
    direct_transport,
    once,
    radiance,
    surface_maps,
)
from sfsnet_dr.scene.jit import dr, mi, upload
from sfsnet_dr.scene.lights import SceneLight
from sfsnet_dr.scene.subject import Subject

Array = npt.NDArray[np.float64]
Planes = npt.NDArray[np.float32]
Backend = Literal["numpy", "torch", "drjit"]
Kind = Literal["visibility", "bounce"]


class ShadingRenderer:
    """``f_render`` on a subject's normals and albedo; nothing shadows anything.

    Args:
        backend: the implementation.
        order: of the light, 0 to 4.
    """

    def __init__(self, backend: Backend, order: int) -> None:
        self.name = f"{backend}-order{order}"
        self.capabilities = Capabilities(visibility=False, order=order)
        self._form, self._order = _SHADING[backend], order

    def render(self, subject: Subject, light: SceneLight, budget: Budget) -> Image:
        """An image (H, W, 3): float64 by NumPy, else float32."""
        maps = surface_maps(subject, budget.seed)
        shading = radiance(light).truncate(self._order).to_shading().flat()[None]
        return np.moveaxis(self._form(maps.normal, maps.albedo, shading)[0], 0, -1)


class TransportRenderer:
    """A subject's light transport, weighed by the light's coefficients.

    Args:
        backend: the implementation.
        order: of the light, 0 to 4.
        kind: whether the transport holds direct light with its shadows, or one bounce too.
    """

    def __init__(self, backend: Literal["numpy", "drjit"], order: int, kind: Kind) -> None:
        self.name = f"{backend}-order{order}-{kind}"
        self.capabilities = Capabilities(visibility=True, bounces=int(kind == "bounce"), order=order)
        self._answers, self._weigh = _TRANSPORT[backend][kind], _WEIGH[backend]
        self._order = order

    def render(self, subject: Subject, light: SceneLight, budget: Budget) -> Image:
        """An image (H, W, 3): float64 by NumPy, float32 by Dr.Jit."""
        return self._weigh(self._answers(subject, budget.seed), radiance(light).truncate(self._order).values)


def _by_numpy(normal: Planes, albedo: Planes, shading: Array) -> Image:
    return shading_numpy.f_render(normal, albedo, shading)


def _by_torch(normal: Planes, albedo: Planes, shading: Array) -> Image:
    return _tensors(shading_torch.f_render, normal, albedo, shading)


def _by_drjit(normal: Planes, albedo: Planes, shading: Array) -> Image:
    return _tensors(shading_drjit.f_render, normal, albedo, shading)


def _tensors(form: Callable[..., torch.Tensor], *arrays: npt.NDArray[np.floating]) -> Image:
    return form(*(torch.from_numpy(array.astype(np.float32, copy=False)) for array in arrays)).numpy()


class _Uploaded:
    """Transport in Dr.Jit's memory: a colour a pixel for each basis light."""

    def __init__(self, transport: Planes) -> None:
        self.shape = transport.shape[1:]
        self.responses = [
            mi.Color3f(*(upload(mi.Float, response[..., c]) for c in range(3))) for response in transport
        ]


def _weighed_by_numpy(transport: Planes, light: Array) -> Image:
    """sum_k T_k l_k, added up in float64."""
    image = np.zeros(transport.shape[1:])
    for response, weight in zip(transport, light, strict=False):
        image += response * weight
    return image


def _weighed_by_drjit(transport: _Uploaded, light: Array) -> Image:
    """The same in one kernel, which is the same for every light."""
    weights, total = upload(mi.Float, light), mi.Color3f(0.0)
    for k, response in enumerate(transport.responses[: len(light)]):
        weight = mi.Color3f(*(dr.gather(mi.Float, weights, mi.UInt32(3 * k + c)) for c in range(3)))
        total = dr.fma(response, weight, total)
    dr.eval(total)
    return np.asarray(total, dtype=np.float32).T.reshape(transport.shape)


_SHADING: Final[dict[str, Callable[[Planes, Planes, Array], Image]]] = {
    "numpy": _by_numpy,
    "torch": _by_torch,
    "drjit": _by_drjit,
}
_TRANSPORT: Final[dict[str, dict[str, Callable[[Subject, int], Any]]]] = {
    "numpy": {"visibility": direct_transport, "bounce": bounced_transport},
    "drjit": {
        "visibility": once(lambda subject, seed: _Uploaded(direct_transport(subject, seed))),
        "bounce": once(lambda subject, seed: _Uploaded(bounced_transport(subject, seed))),
    },
}
_WEIGH: Final[dict[str, Callable[[Any, Array], Image]]] = {
    "numpy": _weighed_by_numpy,
    "drjit": _weighed_by_drjit,
}
