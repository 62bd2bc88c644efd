"""A face under any light, from its light transport: image = sum_k transport_k l_k.

Convention:
    ``transport[k]`` is the image under the light of radiance Y_k, albedo and visibility included, and the
    light is given by radiance coefficients; shading coefficients would count the cosine kernel twice.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from sfsnet_dr.base.checks import check_shape
from sfsnet_dr.sh.coefficients import Radiance


def relight(transport: NDArray[np.floating], light: Radiance) -> NDArray[np.float64]:
    """Relight one face.

    Args:
        transport: (K, H, W, 3), as in a bundle.
        light: radiance coefficients of the same number K of basis functions.

    Returns:
        Linear image (H, W, 3), not clamped.

    Raises:
        BadInput: if the number of coefficients differs.
        TypeError: for shading coefficients or bare numbers.
    """
    if not isinstance(light, Radiance):
        raise TypeError(f"light: {type(light).__name__} found, Radiance is needed; convert it first")
    check_shape("transport", transport, "K H W 3", K=len(light.values))
    image: NDArray[np.float64] = np.einsum("khwc,kc->hwc", np.asarray(transport, np.float64), light.values)
    return image


def relight_batch(transport: Tensor, radiance: Tensor) -> Tensor:
    """Relight a batch of faces, each under its light, in float32.

    Args:
        transport: (B, K, 3, H, W), any floating type.
        radiance: radiance coefficients (B, K, 3).

    Returns:
        Linear images (B, 3, H, W), not clamped.

    Raises:
        BadInput: if the shapes do not fit.
    """
    sizes = check_shape("transport", transport, "B K 3 H W")
    check_shape("radiance", radiance, "B K 3", B=sizes["B"], K=sizes["K"])
    image = torch.zeros(sizes["B"], 3, sizes["H"], sizes["W"], device=transport.device)
    for k in range(sizes["K"]):
        # Term by term: a product over all K at once would first make a float32 copy of the transport.
        image.addcmul_(transport[:, k].float(), radiance[:, k, :, None, None].float())
    return image
