"""Rotation of spherical-harmonic light."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.coefficients import Radiance, Shading
from sfsnet_dr.sh.kernel import check_order, order_of

Light = TypeVar("Light", Radiance, Shading)

#: Largest entry of R^T R - 1 that still counts as orthogonal: float32 matrices reach 1e-6.
_ORTHOGONAL_WITHIN = 1e-5


def rotation_matrix(rotation: ArrayLike, order: int) -> NDArray[np.float64]:
    """Matrix M with ``new = M @ old`` for the light turned by R: new(d) = old(R^T d).

    Every entry M[k, k'] is the integral of Y_k(d) Y_k'(R^T d) over the sphere, by a quadrature that is exact
    for the polynomials in it. M is block-diagonal by band, orthogonal, and M(R1 R2) = M(R1) M(R2).

    Args:
        rotation: (3, 3) orthogonal. Reflections are welcome: diag(-1, 1, 1) mirrors the light left to right.
        order: 0 to 8.

    Returns:
        (K, K) float64.

    Raises:
        InputError: if the matrix is not (3, 3) and orthogonal.
    """
    matrix = _check_orthogonal(rotation)
    directions, weights = sphere_quadrature(2 * check_order(order))
    return np.asarray(
        (sh_basis(directions, order) * weights[:, None]).T @ sh_basis(directions @ matrix, order)
    )


def rotate(light: Light, rotation: ArrayLike) -> Light:
    """Turn the light by a rotation (or mirror it): what came from direction d then comes from R d."""
    return type(light)(rotation_matrix(rotation, light.order) @ light.values)


def rotate_each(values: NDArray[np.float64], rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn many lights at once, each by its own rotation: coefficients (B, K, C), rotations (B, 3, 3)."""
    order = order_of(values.shape[1])
    directions, weights = sphere_quadrature(2 * order)
    seen = np.einsum("bpk,bkc->bpc", sh_basis(directions @ rotations, order), values)
    return np.asarray(np.einsum("pk,bpc->bkc", sh_basis(directions, order) * weights[:, None], seen))


def sphere_quadrature(degree: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Directions (N, 3) and weights (N,) that integrate spherical polynomials up to a degree exactly.

    Gauss-Legendre in z times equal steps in azimuth. The weights sum to 4 pi.
    """
    z, z_weights = np.polynomial.legendre.leggauss(degree // 2 + 1)
    steps = degree + 1
    phi = 2 * np.pi * np.arange(steps) / steps
    sine = np.sqrt(1 - z**2)
    directions = np.stack(
        [np.outer(sine, np.cos(phi)), np.outer(sine, np.sin(phi)), np.repeat(z[:, None], steps, axis=1)],
        axis=-1,
    )
    return directions.reshape(-1, 3), np.repeat(z_weights * 2 * np.pi / steps, steps)


def _check_orthogonal(rotation: ArrayLike) -> NDArray[np.float64]:
    matrix = np.asarray(rotation, dtype=np.float64)
    if matrix.shape != (3, 3):
        raise InputError(f"rotation: shape {matrix.shape} found, (3, 3) expected")
    error = float(np.abs(matrix.T @ matrix - np.eye(3)).max())
    if not error <= _ORTHOGONAL_WITHIN:  # also catches NaN
        raise InputError(
            f"rotation: R^T R differs from 1 by {error:.3g}, at most {_ORTHOGONAL_WITHIN} allowed"
        )
    return matrix
