"""Images as light transport times light: one linear operator, in NumPy, torch and Dr.Jit.

A fixed face under a fixed camera answers linearly to light (precomputed radiance transfer, Sloan et al.
2002): ``image = sum_k T_k l_k + sum_k G_k l_k + sum_d D_d e_d`` with the transport T (K, H, W, 3), its mirror
images G (9, H, W) in the gloss, directional responses D (D, H, W, 3), radiance coefficients l and irradiances
e. NumPy adds up in float64 and is the reference of the other two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.scene.lights.light import SNAP_DEG, Light
from sfsnet_dr.sh.coefficients import Radiance
from sfsnet_dr.sh.kernel import order_of
from sfsnet_dr.sh.projection import project_directional

if TYPE_CHECKING:
    from torch import Tensor

Array = NDArray[np.float64]
Floats = NDArray[np.floating]

#: Responses of the glossy part, of order 2; 0 without gloss.
GLOSS_COUNTS = (0, 9)


@dataclass(frozen=True, eq=False)
class ResponseWeights:
    """A light as weights of a face's responses.

    Attributes:
        radiance: (K, 3) of the transport; its first 9 also of the gloss.
        irradiance: (D, 3) of the directional responses.
    """

    radiance: Array
    irradiance: Array


class HasTransport(Protocol):
    """What holds a face's responses: a bundle, or rendered maps."""

    @property
    def transport(self) -> Floats:
        """(K, H, W, 3) responses to the radiance basis."""

    @property
    def gloss(self) -> Floats:
        """(9, H, W) or (0, H, W): their mirror images."""

    @property
    def directional(self) -> Floats:
        """(D, H, W, 3) responses to directional lights of irradiance 1."""


@dataclass(frozen=True, eq=False)
class Transport:
    """The light transport of one face: everything that is needed to relight it.

    Attributes:
        transport: (K, H, W, 3) responses to the radiance basis, K = 9 or 25: visibility and interreflection
            included, without the mirror image of the light in the gloss.
        gloss: (9, H, W) these mirror images, equal in all colours; (0, H, W) for a diffuse surface.
        directional: (D, H, W, 3) responses to directional lights of irradiance 1: hard shadows.
        directions: (D, 3) unit vectors toward these lights.

    Raises:
        InputError: if shapes do not fit.
    """

    transport: Floats
    gloss: Floats
    directional: Floats
    directions: Array

    def __post_init__(self) -> None:
        sizes = check_shape("transport", self.transport, "K H W 3")
        outer = {name: sizes[name] for name in ("H", "W")}
        order_of(sizes["K"])
        _check_gloss(check_shape("gloss", self.gloss, "G H W", **outer)["G"], sizes["K"])
        count = check_shape("directional", self.directional, "D H W 3", **outer)["D"]
        check_shape("directions", self.directions, "D 3", D=count)

    @classmethod
    def of(cls, maps: HasTransport, directions: Array | None = None) -> Transport:
        """Return the transport of a bundle (which knows its directions) or of rendered maps.

        Args:
            maps: a ``Bundle``, or what ``render_aovs`` gives.
            directions: (D, 3) that the maps were rendered with; left out, the bundle's, or none.
        """
        if directions is None:
            directions = getattr(maps, "directions", np.zeros((0, 3)))
        return cls(maps.transport, maps.gloss, maps.directional, np.asarray(directions, np.float64))

    def relight(self, light: Light) -> Array:
        """Return the linear image (H, W, 3) under a light, not clamped.

        Directional lights within ``SNAP_DEG`` degrees of one of ``directions`` cast hard shadows; others are
        softened as by thin cloud (``Light.softened``), for coefficients cannot hold them.
        """
        weights = response_weights(
            light.softened(self.directions), self.directions, order_of(len(self.transport))
        )
        return relight_responses(self.transport, self.gloss, self.directional, weights)


def response_weights(light: Light, directions: Array, order: int) -> ResponseWeights:
    """Split a light over the responses of a face.

    Directional lights within ``SNAP_DEG`` degrees of a direction go to the response of the nearest one, sharp
    as it is; others go with the map into the coefficients, which smear them and their shadows. Give
    ``sample_scene_light`` the same directions, and strong lights fit.

    Args:
        light: the light.
        directions: (D, 3) unit vectors of the directional responses; (0, 3) for none.
        order: of the transport.
    """
    check_shape("directions", directions, "D 3")
    radiance = light.environment_coefficients(order)
    irradiance = np.zeros((len(directions), 3))
    for toward, power in light.directional:
        cosines = directions @ toward
        if len(cosines) and cosines.max() >= np.cos(np.radians(SNAP_DEG)):
            irradiance[cosines.argmax()] += power
        else:
            radiance = radiance + project_directional(toward, power, order)
    return ResponseWeights(radiance.values, irradiance)


def relight_transport(transport: Floats | Transport, light: Radiance | Light) -> Array:
    """Return the image of one face under a light.

    Args:
        transport: responses (K, H, W, 3) to the radiance basis, or a ``Transport`` with gloss and lamps.
        light: radiance coefficients of the same number K; with a ``Transport`` also a ``Light``.

    Returns:
        Linear image (H, W, 3) float64, not clamped.

    Raises:
        InputError: if the number of coefficients differs.
        TypeError: for shading coefficients or bare numbers.

    Example:
        >>> import numpy as np
        >>> import sfsnet_dr as sf
        >>> transport = np.zeros((9, 2, 2, 3))
        >>> transport[0] = 0.5
        >>> light = sf.sh.Radiance(np.ones((9, 3)))
        >>> sf.relight_transport(transport, light)[0, 0].tolist()
        [0.5, 0.5, 0.5]
    """
    if isinstance(transport, Transport):
        if isinstance(light, Light):
            return transport.relight(light)
        if isinstance(light, Radiance):
            nothing = np.zeros((len(transport.directional), 3))
            weights = ResponseWeights(light.values, nothing)
            return relight_responses(transport.transport, transport.gloss, transport.directional, weights)
    elif isinstance(light, Light):
        light = light.coefficients(order_of(check_shape("transport", transport, "K H W 3")["K"]))
    if not isinstance(light, Radiance):
        raise TypeError(f"light: {type(light).__name__} found, Radiance is needed; convert it first")
    responses = transport.transport if isinstance(transport, Transport) else transport
    check_shape("transport", responses, "K H W 3", K=len(light.values))
    image: Array = np.einsum("khwc,kc->hwc", np.asarray(responses, np.float64), light.values)
    return image


def relight_responses(transport: Floats, gloss: Floats, directional: Floats, light: ResponseWeights) -> Array:
    """Relight one face with all its responses; the reference in NumPy.

    Args:
        transport: (K, H, W, 3).
        gloss: (9, H, W), or (0, H, W) for a surface without.
        directional: (D, H, W, 3).
        light: what ``response_weights`` gives for the transport's order and the directions.

    Returns:
        Linear image (H, W, 3), not clamped: the ringing of a sharp light's coefficients may be negative.

    Raises:
        InputError: if shapes do not fit.
    """
    sizes = check_shape("transport", transport, "K H W 3", K=len(light.radiance))
    sizes = {name: sizes[name] for name in ("H", "W")}
    _check_gloss(check_shape("gloss", gloss, "G H W", **sizes)["G"], len(light.radiance))
    check_shape("directional", directional, "D H W 3", D=len(light.irradiance), **sizes)
    image = relight_transport(transport, Radiance(light.radiance))
    image += np.einsum("khw,kc->hwc", np.asarray(gloss, np.float64), light.radiance[: len(gloss)])
    image += np.einsum("dhwc,dc->hwc", np.asarray(directional, np.float64), light.irradiance)
    return image


def relight_batch(
    transport: Tensor,
    radiance: Tensor,
    gloss: Tensor | None = None,
    directional: Tensor | None = None,
    irradiance: Tensor | None = None,
) -> Tensor:
    """Relight a batch of faces in torch, each under its light, in float32; differentiable.

    Args:
        transport: (B, K, 3, H, W), any floating type.
        radiance: radiance coefficients (B, K, 3).
        gloss: (B, 9, H, W); None leaves gloss out.
        directional: (B, D, 3, H, W), together with ``irradiance`` (B, D, 3); None for no directional light.
        irradiance: (B, D, 3).

    Returns:
        Linear images (B, 3, H, W), not clamped.

    Raises:
        InputError: if shapes do not fit, or one of ``directional`` and ``irradiance`` is missing.
    """
    import torch

    sizes = check_shape("transport", transport, "B K 3 H W")
    check_shape("radiance", radiance, "B K 3", B=sizes["B"], K=sizes["K"])
    if (directional is None) != (irradiance is None):
        raise InputError("relight_batch: directional and irradiance belong together, one of them found")
    image = torch.zeros(sizes["B"], 3, sizes["H"], sizes["W"], device=transport.device)
    image = _add_responses(image, transport, radiance)
    outer = {name: sizes[name] for name in ("B", "H", "W")}
    if gloss is not None:
        count = check_shape("gloss", gloss, "B G H W", **outer)["G"]
        _check_gloss(count, sizes["K"])
        image = _add_responses(image, gloss[:, :, None], radiance[:, :count])
    if directional is not None and irradiance is not None:
        count = check_shape("directional", directional, "B D 3 H W", **outer)["D"]
        check_shape("irradiance", irradiance, "B D 3", B=sizes["B"], D=count)
        image = _add_responses(image, directional, irradiance)
    return image


def _add_responses(image: Tensor, responses: Tensor, weights: Tensor) -> Tensor:
    """Term by term: a product over all at once would first make a float32 copy of the responses."""
    grad = responses.requires_grad or weights.requires_grad
    add = image.addcmul if grad else image.addcmul_
    for k in range(responses.shape[1]):
        image = add(responses[:, k].float(), weights[:, k, :, None, None].float())
        add = image.addcmul if grad else image.addcmul_
    return image


def _check_gloss(count: int, coefficients: int) -> None:
    if count not in GLOSS_COUNTS or count > coefficients:
        raise InputError(f"gloss: {count} responses found, 0 or 9, and no more than the transport, allowed")


class DrjitTransport:
    """Transport in the memory of Dr.Jit: a colour a pixel for each basis light, a number for each of gloss.

    Args:
        transport: (K, H, W, 3).
        gloss: (G, H, W).
    """

    def __init__(self, transport: Floats, gloss: Floats | None = None) -> None:
        from sfsnet_dr.scene.jit import mi, upload_array

        self.shape = transport.shape[1:]
        self.responses = [
            mi.Color3f(*(upload_array(mi.Float, response[..., c]) for c in range(3)))
            for response in transport
        ]
        self.gloss = [upload_array(mi.Float, response) for response in (() if gloss is None else gloss)]

    def relight(self, radiance: Array) -> NDArray[np.float32]:
        """Return the image (H, W, 3) under coefficients (K', 3), K' <= K, by one kernel for every light."""
        from sfsnet_dr.scene.jit import dr

        total = weigh_responses(self.responses[: len(radiance)], self.gloss, drjit_weights(radiance))
        dr.eval(total)
        return np.asarray(total, dtype=np.float32).T.reshape(self.shape)


def drjit_weights(radiance: Array) -> list[Any]:
    """Return coefficients (K, 3) as ``mi.Color3f`` that change without a new compilation."""
    from sfsnet_dr.scene.jit import dr, mi

    return [mi.Color3f(*(dr.opaque(mi.Float, float(x)) for x in row)) for row in radiance]


def weigh_responses(responses: Sequence[Any], gloss: Sequence[Any], light: Sequence[Any]) -> Any:
    """Return ``sum_k T_k l_k + sum_k G_k l_k`` as a ``mi.Color3f`` that is not evaluated yet.

    Args:
        responses: K colours a pixel.
        gloss: numbers a pixel, at most K; they take the first coefficients.
        light: K colours, as of ``drjit_weights``.
    """
    from sfsnet_dr.scene.jit import dr, mi

    total = responses[0] * light[0]
    for response, weight in zip(responses[1:], light[1:], strict=True):
        total = dr.fma(response, weight, total)
    for response, weight in zip(gloss, light, strict=False):
        total = dr.fma(mi.Color3f(response), weight, total)
    return total
