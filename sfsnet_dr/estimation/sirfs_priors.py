"""What ``fit.intrinsic`` holds to be likely of albedo, shape and light. All terms are means, one an image."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.conventions import LIGHT_ORDER
from sfsnet_dr.scene.lights.photo_prior import read_mixture
from sfsnet_dr.sh.basis import sh_basis
from sfsnet_dr.sh.icosphere import icosphere
from sfsnet_dr.sh.kernel import band_of, clamped_cosine

#: Change of log-albedo between neighbours that is a change of paint.
_EDGE: Final = 0.05
#: Width of a value of log-albedo.
_VALUE: Final = 0.1
#: Partners of each pixel in the estimate of the entropy.
_PARTNERS: Final = 4
#: Rate of change of mean curvature (per squared width of the image) from which it counts as a crease.
_CREASE: Final = 40.0
#: Lights behind the prior: plain lamps to this angle from the viewer, and shares of ambient light.
_LARGEST_ANGLE: Final = 100.0
_AMBIENT: Final = (0.0, 0.2, 0.4, 0.6, 0.8)


def albedo_edges(albedo: Tensor, mask: Tensor) -> Tensor:
    """Cauchy's penalty log(1 + (d / 0.05)^2) on differences of neighbours in log-albedo (B, 1, S, S)."""
    total, count = albedo.new_zeros(len(albedo)), albedo.new_zeros(len(albedo))
    for dim in (-1, -2):
        size = albedo.shape[dim]
        step = (albedo.narrow(dim, 1, size - 1) - albedo.narrow(dim, 0, size - 1)) / _EDGE
        both = mask.narrow(dim, 1, size - 1) * mask.narrow(dim, 0, size - 1)
        total = total + (both * torch.log1p(step * step)).sum((1, 2, 3))
        count = count + both.sum((1, 2, 3))
    return total / count


def draw_pairs(size: int) -> Tensor:
    """Partners of each of size^2 pixels, (4, size^2): fixed permutations."""
    generator = torch.Generator().manual_seed(0)
    return torch.stack([torch.randperm(size * size, generator=generator) for _ in range(_PARTNERS)])


def albedo_entropy(albedo: Tensor, mask: Tensor, pairs: Tensor) -> Tensor:
    """Quadratic (Renyi) entropy of log-albedo, -log mean exp(-(a - b)^2 / (4 s^2)) over pairs, (B,).

    Least where a few values are taken by all pixels, wherever they lie. Source: SIRFS, parsimony.
    """
    flat, weight = albedo.flatten(1), mask.flatten(1)
    near, count = albedo.new_zeros(len(albedo)), albedo.new_zeros(len(albedo))
    for row in pairs:
        off = (flat - flat[:, row]) / (2 * _VALUE)
        both = weight * weight[:, row]
        near = near + (both * torch.exp(-off * off)).sum(1)
        count = count + both.sum(1)
    return -torch.log(near / count + 1e-4)


def bending_energy(depth: Tensor, mask: Tensor) -> Tensor:
    """Penalty on changes of a depth map's mean curvature, (B,): planes and spheres have none."""
    curvature = mean_curvature(depth)
    total, count = depth.new_zeros(len(depth)), depth.new_zeros(len(depth))
    unit = depth.shape[-1] ** 2 / _CREASE
    inner = mask[..., 1:-1, 1:-1]
    for dim in (-1, -2):
        size = curvature.shape[dim]
        step = (curvature.narrow(dim, 1, size - 1) - curvature.narrow(dim, 0, size - 1)) * unit
        both = inner.narrow(dim, 1, size - 1) * inner.narrow(dim, 0, size - 1)
        total = total + (both * (torch.sqrt(1 + step * step) - 1)).sum((1, 2, 3))
        count = count + both.sum((1, 2, 3))
    return total / count


def mean_curvature(depth: Tensor) -> Tensor:
    """Of the inner pixels of a depth map (B, 1, S, S), 1 / pixel, (B, 1, S - 2, S - 2); > 0 in hollows."""
    middle = depth[..., 1:-1, 1:-1]
    left, right = depth[..., 1:-1, :-2], depth[..., 1:-1, 2:]
    above, below = depth[..., :-2, 1:-1], depth[..., 2:, 1:-1]
    x, y = (right - left) / 2, (below - above) / 2
    xx, yy = left + right - 2 * middle, above + below - 2 * middle
    xy = (depth[..., 2:, 2:] + depth[..., :-2, :-2] - depth[..., 2:, :-2] - depth[..., :-2, 2:]) / 4
    squared = 1 + x * x + y * y
    return ((1 + x * x) * yy - 2 * x * y * xy + (1 + y * y) * xx) / (2 * squared * squared.sqrt())


def outline_energy(mask: Tensor) -> tuple[Tensor, Tensor]:
    """Where a mask (B, 1, S, S) ends outward.

    Holes in it (eyes, mouth) and the picture's border are no outline: only what can be seen from outside of
    the mask's hull in its row or column counts.

    Returns:
        Directions outward, x right and y up, (B, 2, S, S), and weights that sum to 1, (B, 1, S, S).
    """
    solid = _without_holes(mask)
    blurred = functional.avg_pool2d(functional.pad(solid, (3, 3, 3, 3)), 7, stride=1)
    padded = functional.pad(blurred, (1, 1, 1, 1), mode="replicate")
    x = padded[..., 1:-1, :-2] - padded[..., 1:-1, 2:]
    y = padded[..., 2:, 1:-1] - padded[..., :-2, 1:-1]
    length = torch.sqrt(x * x + y * y)
    outward = torch.cat([x, y], 1) / length.clamp_min(1e-6)
    edge = mask * (length > 1e-3) * (1 - _shrunk(solid))
    edge[..., 0, :] = edge[..., -1, :] = 0
    edge[..., :, 0] = edge[..., :, -1] = 0
    return outward, edge / edge.sum((1, 2, 3), keepdim=True).clamp_min(1e-6)


def _without_holes(mask: Tensor) -> Tensor:
    """1 where the mask is reached both ways along the row and both ways along the column."""
    on = (mask > 0.5).float()
    solid = torch.ones_like(on)
    for dim in (-1, -2):
        forth = on.cummax(dim).values
        back = on.flip(dim).cummax(dim).values.flip(dim)
        solid = solid * forth * back
    return solid


def _shrunk(solid: Tensor) -> Tensor:
    """Without the two outermost pixels; the picture's border is no end."""
    return -functional.max_pool2d(functional.pad(-solid, (2, 2, 2, 2), value=-1.0), 5, stride=1)


@cache
def natural_lights() -> tuple[Tensor, Tensor]:
    """Mean (9,) and root of the covariance (9, 9) of the luminance of lights, in units of mean shading.

    Half are the lights of photographs (``sh.light_mixture``), half single lamps before or beside the face
    with more or less ambient light, as databases of lamps have them.
    """
    drawn = read_mixture().draw(np.random.default_rng(0), 4000).reshape(-1, 3, 9)
    photographed = np.einsum("nck,c->nk", drawn, LUMINANCE)
    directions = icosphere(3)
    near = directions[directions[:, 2] >= np.cos(np.radians(_LARGEST_ANGLE))]
    lamps = sh_basis(near, LIGHT_ORDER) * (clamped_cosine(LIGHT_ORDER) / np.pi)[band_of(LIGHT_ORDER)]
    visible = directions[directions[:, 2] >= 0.5]
    shown = sh_basis(visible, LIGHT_ORDER)
    ambient = np.eye(1, lamps.shape[1])
    level = (shown @ lamps.T).mean(0)[:, None].clip(0.1)
    plain = [share * ambient / shown[0, 0] + (1 - share) * lamps / level for share in _AMBIENT]
    rows = np.concatenate(plain)
    mean = (photographed.mean(0) + rows.mean(0)) / 2
    both = [(part - mean).T @ (part - mean) / len(part) for part in (photographed, rows)]
    root = np.linalg.cholesky((both[0] + both[1]) / 2 + 1e-4 * np.eye(len(mean)))
    return torch.tensor(mean, dtype=torch.float32), torch.tensor(root, dtype=torch.float32)
