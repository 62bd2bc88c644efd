"""A face under any light, from its light transport: image = sum_k transport_k l_k.

Convention:
    ``transport[k]`` is the image under the light of radiance Y_k, albedo and visibility included, and the
    light is given by radiance coefficients; shading coefficients would count the cosine kernel twice.
    ``gloss[k]`` (monochrome, order 2) is what the surface mirrors of Y_k, ``lamps[d]`` the image under a
    directional light of irradiance 1 from the d-th direction, gloss and hard shadows included.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.data.bundle import Bundle
from sfsnet_dr.data.transforms.background import sample_surroundings
from sfsnet_dr.data.transforms.camera import PhotoOptions, photograph, sample_effects
from sfsnet_dr.scene.lights.light import NEAR, Light
from sfsnet_dr.scene.spec import CameraSpec
from sfsnet_dr.sh.coefficients import Radiance
from sfsnet_dr.sh.kernel import order_of
from sfsnet_dr.sh.projection import project_directional

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Mixture:
    """A light as weights of a face's responses.

    Attributes:
        radiance: (K, 3) of the transport; its first 9 also of the gloss.
        irradiance: (D, 3) of the directional responses.
    """

    radiance: Array
    irradiance: Array


def mixture(light: Light, directions: Array, order: int) -> Mixture:
    """Split a light over what a face's transport knows.

    Directional lights within ``NEAR`` degrees of a transport's direction go to the response of the nearest
    one, sharp as it is; others go with the map into the coefficients, which smear them and their shadows.
    Give ``scene.light_sources.sample_scene_light`` the same directions, and strong lights fit.

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
        if len(cosines) and cosines.max() >= np.cos(np.radians(NEAR)):
            irradiance[cosines.argmax()] += power
        else:
            radiance = radiance + project_directional(toward, power, order)
    return Mixture(radiance.values, irradiance)


def relight(bundle: Bundle, light: Light, photo: PhotoOptions | None = None, seed: int = 0) -> Array:
    """One rendered face under any light, and photographed if wanted.

    All that the bundle knows takes part: interreflection, gloss, and hard shadows of lights within ``NEAR``
    degrees of its directions (``bundle.directions``). Other suns and lamps are softened as by thin cloud
    (``Light.softened``): coefficients cannot hold them.

    Args:
        bundle: the face.
        light: the light; ``scene.light_sources.sample_scene_light`` draws one, given the bundle's directions
            one that stays hard.
        photo: what may happen between the face and the picture: exposure, white balance, sensor noise, blur,
            JPEG, grey, and a background under the same light. None for the bare face on black.
        seed: of all that is drawn for the photograph.

    Returns:
        Linear image (H, W, 3): a photograph within [0, 1], else neither clipped above nor below.

    Raises:
        InputError: for a bundle that is not square when a photograph is wanted.
    """
    soft = light.softened(bundle.directions)
    weights = mixture(soft, bundle.directions, order_of(len(bundle.transport)))
    image = relight_scene(bundle.transport, bundle.gloss, bundle.lamps, weights)
    if photo is None:
        return image
    size = check_shape("bundle", bundle.mask, "N N")["N"]
    rng = np.random.default_rng(seed)
    distance = float(bundle.meta.extra.get("pose", {}).get("distance", CameraSpec().distance))
    place = sample_surroundings(rng, soft, distance, size)
    planes = (torch.from_numpy(np.moveaxis(part, -1, 0).copy())[None] for part in (image, place))
    coverage = torch.from_numpy(bundle.coverage.copy())[None, None]
    taken = photograph(next(planes), coverage, next(planes), [sample_effects(rng, photo)])
    return np.asarray(np.moveaxis(taken[0].numpy(), 0, -1), np.float64)


def relight_transport(transport: NDArray[np.floating], light: Radiance) -> Array:
    """One face under smooth light, from its transport alone.

    Args:
        transport: (K, H, W, 3), as in a bundle.
        light: radiance coefficients of the same number K of basis functions.

    Returns:
        Linear image (H, W, 3), not clamped.

    Raises:
        InputError: if the number of coefficients differs.
        TypeError: for shading coefficients or bare numbers.
    """
    if not isinstance(light, Radiance):
        raise TypeError(f"light: {type(light).__name__} found, Radiance is needed; convert it first")
    check_shape("transport", transport, "K H W 3", K=len(light.values))
    image: Array = np.einsum("khwc,kc->hwc", np.asarray(transport, np.float64), light.values)
    return image


def relight_scene(
    transport: NDArray[np.floating],
    gloss: NDArray[np.floating],
    lamps: NDArray[np.floating],
    light: Mixture,
) -> Array:
    """Relight one face with all its responses.

    Args:
        transport: (K, H, W, 3).
        gloss: (9, H, W), or (0, H, W) for a surface without.
        lamps: (D, H, W, 3).
        light: what ``mixture`` gives for the transport's order and the lamps' directions.

    Returns:
        Linear image (H, W, 3), not clamped: the ringing of a sharp light's coefficients may be negative.

    Raises:
        InputError: if shapes do not fit.
    """
    sizes = check_shape("transport", transport, "K H W 3", K=len(light.radiance))
    sizes = {name: sizes[name] for name in ("H", "W")}
    _check_gloss(check_shape("gloss", gloss, "G H W", **sizes)["G"], len(light.radiance))
    check_shape("lamps", lamps, "D H W 3", D=len(light.irradiance), **sizes)
    image = relight_transport(transport, Radiance(light.radiance))
    image += np.einsum("khw,kc->hwc", np.asarray(gloss, np.float64), light.radiance[: len(gloss)])
    image += np.einsum("dhwc,dc->hwc", np.asarray(lamps, np.float64), light.irradiance)
    return image


def relight_batch(
    transport: Tensor,
    radiance: Tensor,
    gloss: Tensor | None = None,
    lamps: Tensor | None = None,
    irradiance: Tensor | None = None,
) -> Tensor:
    """Relight a batch of faces, each under its light, in float32.

    Args:
        transport: (B, K, 3, H, W), any floating type.
        radiance: radiance coefficients (B, K, 3).
        gloss: (B, 9, H, W); None leaves gloss out.
        lamps: (B, D, 3, H, W), together with ``irradiance`` (B, D, 3); None for no directional light.

    Returns:
        Linear images (B, 3, H, W), not clamped.

    Raises:
        InputError: if the shapes do not fit, or one of ``lamps`` and ``irradiance`` is missing.
    """
    sizes = check_shape("transport", transport, "B K 3 H W")
    check_shape("radiance", radiance, "B K 3", B=sizes["B"], K=sizes["K"])
    if (lamps is None) != (irradiance is None):
        raise InputError("relight_batch: lamps and irradiance belong together, one of them found")
    image = torch.zeros(sizes["B"], 3, sizes["H"], sizes["W"], device=transport.device)
    _add_responses(image, transport, radiance)
    outer = {name: sizes[name] for name in ("B", "H", "W")}
    if gloss is not None:
        count = check_shape("gloss", gloss, "B G H W", **outer)["G"]
        _check_gloss(count, sizes["K"])
        _add_responses(image, gloss[:, :, None], radiance[:, :count])
    if lamps is not None and irradiance is not None:
        count = check_shape("lamps", lamps, "B D 3 H W", **outer)["D"]
        check_shape("irradiance", irradiance, "B D 3", B=sizes["B"], D=count)
        _add_responses(image, lamps, irradiance)
    return image


def _add_responses(image: Tensor, responses: Tensor, weights: Tensor) -> None:
    """Term by term: a product over all at once would first make a float32 copy of the responses."""
    for k in range(responses.shape[1]):
        image.addcmul_(responses[:, k].float(), weights[:, k, :, None, None].float())


def _check_gloss(count: int, coefficients: int) -> None:
    if count not in (0, 9) or count > coefficients:
        raise InputError(f"gloss: {count} responses found, 0 or 9, and no more than the transport, allowed")
