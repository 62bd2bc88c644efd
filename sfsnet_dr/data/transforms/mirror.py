"""Left-right reflection of everything that depends on x: normals, transport and light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from torch import Tensor


def x_parity(order: int) -> NDArray[np.float64]:
    """+1 or -1, (K,): how each basis function changes when x changes sign.

    Reflection takes the azimuth phi to pi - phi: cos(m phi) gains (-1)^m and sin(m phi) gains -(-1)^m.
    """
    signs = []
    for band in range(order + 1):
        signs.append(1.0)
        for m in range(1, band + 1):
            signs += [(-1.0) ** m, -((-1.0) ** m)]
    return np.array(signs)


def mirror_map(image: Tensor) -> Tensor:
    """Reverse the columns of an image (..., H, W) whose values do not depend on x."""
    return image.flip(-1)


def mirror_normal(normal: Tensor) -> Tensor:
    """Reflect normals (..., 3, H, W): columns reversed and x negated."""
    return normal.flip(-1) * normal.new_tensor([-1.0, 1.0, 1.0])[:, None, None]


def mirror_transport(transport: Tensor) -> Tensor:
    """Reflect transport (..., K, 3, H, W): the reflected face under Y_k is the face under +-Y_k."""
    order = int(transport.shape[-4] ** 0.5) - 1
    signs = transport.new_tensor(x_parity(order))
    return transport.flip(-1) * signs[:, None, None, None]


def mirror_light(light: Tensor) -> Tensor:
    """Reflect light coefficients (..., 3K), all of red, of green, of blue: those odd in x change sign."""
    count = light.shape[-1] // 3
    return light * light.new_tensor(x_parity(int(count**0.5) - 1)).repeat(3)
