"""A face under any light, from its light transport: image = sum_k transport_k l_k.

Convention:
    ``transport[k]`` is the image under the light of radiance Y_k, albedo and visibility included, and the
    light is given by radiance coefficients; shading coefficients would count the cosine kernel twice.
    ``gloss[k]`` (monochrome, order 2) is what the surface mirrors of Y_k, ``lamps[d]`` the image under a
    directional light of irradiance 1 from the d-th direction, gloss and hard shadows included.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from sfsnet_dr.core.errors import check_shape
from sfsnet_dr.data.bundle import Bundle
from sfsnet_dr.data.transforms.background import sample_surroundings
from sfsnet_dr.data.transforms.camera import PhotoOptions, sample_effects, simulate_photograph
from sfsnet_dr.render.transport_shading import Transport
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.spec import CameraSpec

Array = NDArray[np.float64]


def relight_bundle(bundle: Bundle, light: Light, photo: PhotoOptions | None = None, seed: int = 0) -> Array:
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
    image = Transport.of(bundle).relight(light)
    if photo is None:
        return image
    size = check_shape("bundle", bundle.mask, "N N")["N"]
    rng = np.random.default_rng(seed)
    distance = float(bundle.meta.extra.get("pose", {}).get("distance", CameraSpec().distance))
    place = sample_surroundings(rng, soft, distance, size)
    planes = (torch.from_numpy(np.moveaxis(part, -1, 0).copy())[None] for part in (image, place))
    coverage = torch.from_numpy(bundle.coverage.copy())[None, None]
    taken = simulate_photograph(next(planes), coverage, next(planes), [sample_effects(rng, photo)])
    return np.asarray(np.moveaxis(taken[0].numpy(), 0, -1), np.float64)
