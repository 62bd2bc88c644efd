"""Shape, albedo and light from one image by optimisation under priors, in the spirit of SIRFS.

Unknown are a depth map (64 x 64, as a sum over a pyramid, so that coarse and fine shape move together) and
nine shading coefficients; the log-albedo is what they leave of the log-luminance,

    a = log(I + e) - log(S+ + e),    S = Y(n)^T L,    n of the depth's slopes,  S+ a soft max(S, 0),

so that every answer explains the image, and Adam makes the most likely one of them by the priors of
``fit.intrinsic_priors``:

    albedo: few places where it changes (Cauchy on differences), few values (quadratic entropy over pairs)
    shape:  mean curvature that changes little, facing the viewer, turned outward along the mask's outline
    light:  normal over nine numbers, from photographs' lights and plain lamps

No faces are known to it, no shadows, no gloss. What differs from SIRFS: luminance alone decides, the light is
taken to be without tint; one pyramid from coarse to fine in place of L-BFGS on it; the priors' forms above,
with weights found on rendered faces: normals of 24 of them, under lights drawn as for training, are then off
by 19.5 degrees, by 22.4 without the albedo's terms (all that the outline tells), and flat ones by 37.

Source: Barron and Malik, "Shape, illumination, and reflectance from shading", PAMI 2015.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.conventions import LIGHT_ORDER
from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.estimation.sirfs_priors import (
    albedo_edges,
    albedo_entropy,
    bending_energy,
    draw_pairs,
    natural_lights,
    outline_energy,
)
from sfsnet_dr.render.shading_torch import unit
from sfsnet_dr.sh.basis_torch import sh_basis

#: Width of the depth map; larger images are averaged down to it.
SIZE: Final = 64
#: Levels of the pyramid at most, each half as wide as the one before.
_LEVELS: Final = 5
#: Sharpness of the soft maximum of shading and 0, per unit of mean shading.
_SHARP: Final = 20.0
#: Least of the mask's area, in shares of the image.
_LEAST: Final = 0.01


@dataclass(frozen=True)
class IntrinsicOptions:
    """Weights of the priors, each a mean over pixels, and the optimiser's.

    Args:
        edges, entropy, level: of the log-albedo: its changes, its number of values, its distance from 0.5.
        bend, front, contour: of the shape: changes of mean curvature, slant, outward normals at the outline.
        light: of the light's distance from natural ones.
        dome: slant (degrees) at the outline of the dome that the search begins with.
        steps, fine_steps: of Adam at half the size, then at the whole.
        rate: of each first step; a level's unit is a quarter of a pixel of depth for the finest.
        dark: e above, in shares of the mean luminance.
    """

    edges: float = 4.0
    entropy: float = 2.0
    level: float = 2.0
    bend: float = 1.0
    front: float = 8.0
    contour: float = 8.0
    light: float = 1.0
    dome: float = 35.0
    steps: int = 50
    fine_steps: int = 10
    rate: float = 0.1
    dark: float = 0.3

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not value >= 0 or (field.name in ("rate", "dark", "steps", "fine_steps") and not value > 0):
                raise InputError(f"{field.name}: {value} found, a number above 0 is needed")


@dataclass(frozen=True, eq=False)
class Intrinsic:
    """What was found of B images.

    Attributes:
        normal: unit vectors in the camera frame, (B, 3, 64, 64) or as small as the image.
        depth: toward the viewer, in pixels of that map, (B, 1, 64, 64).
        light: shading coefficients of the luminance under an albedo of about 0.5, (B, 9).
        energy: final value of what was minimised, (B,).
    """

    normal: Tensor
    depth: Tensor
    light: Tensor
    energy: Tensor


def solve_intrinsic(images: Tensor, masks: Tensor, options: IntrinsicOptions | None = None) -> Intrinsic:
    """Shape and light of a batch of images; the same images give the same answers, whatever their batch.

    Args:
        images: linear, (B, 3, H, W); square, H a multiple of 64, or of 8 below it.
        masks: share of each pixel that counts, (B, 1, H, W) in [0, 1].
        options: weights; those found on rendered faces if left out.

    Raises:
        InputError: for other shapes or sizes, values that are not finite, a mask below 1 % of an image,
            or an image that is black on it.
    """
    options = options or IntrinsicOptions()
    gray, mask = _prepared(images.detach(), masks.detach())
    search = _Search(_halved(gray * mask) / _halved(mask).clamp_min(1e-3), _halved(mask), options)
    with torch.enable_grad():
        search.run(options.steps)
        search = _Search(gray, mask, options, search)
        search.run(options.fine_steps)
    return search.answer()


def _prepared(images: Tensor, masks: Tensor) -> tuple[Tensor, Tensor]:
    """Luminance of mean 0.5 over the mask, and the mask, both (B, 1, S, S)."""
    sizes = check_shape("images", images, "B 3 N N")
    check_shape("masks", masks, "B 1 N N", B=sizes["B"], N=sizes["N"])
    if sizes["N"] % (SIZE if sizes["N"] > SIZE else 8):
        raise InputError(
            f"images: {sizes['N']} pixels wide found, a multiple of {SIZE}, or of 8 below it, is needed"
        )
    if not (images.isfinite().all() and masks.isfinite().all()):
        raise InputError("images: NaN or inf found, finite values are needed")
    masks = masks.float().clamp(0, 1)
    weights = torch.tensor(LUMINANCE, dtype=torch.float32)[None, :, None, None]
    gray = (images.float() * weights).sum(1, keepdim=True).clamp_min(0)
    block = max(1, sizes["N"] // SIZE)
    share = functional.avg_pool2d(masks, block)
    if sizes["B"] and float(share.mean((1, 2, 3)).min()) < _LEAST:
        raise InputError(f"masks: one covers less than {100 * _LEAST:g} % of its image; a face must be shown")
    gray = functional.avg_pool2d(gray * masks, block) / share.clamp_min(1e-3)
    mean = (gray * share).sum((1, 2, 3), keepdim=True) / share.sum((1, 2, 3), keepdim=True)
    if sizes["B"] and float(mean.min()) <= 1e-6:
        raise InputError("images: one is black on its mask; some light is needed")
    return 0.5 * gray / mean, share


def _halved(planes: Tensor) -> Tensor:
    return functional.avg_pool2d(planes, 2)


class _Search:
    """The unknowns of a batch and what is minimised over them.

    Args:
        gray, mask: (B, 1, S, S).
        options: see there.
        coarse: a search at half the size to go on from.
    """

    def __init__(
        self, gray: Tensor, mask: Tensor, options: IntrinsicOptions, coarse: _Search | None = None
    ) -> None:
        self.options, self.mask = options, mask
        self.bright = (gray + 0.5 * options.dark).log()
        self.pairs = draw_pairs(gray.shape[-1])
        self.outline = outline_energy(mask)
        self.mean, self.root = natural_lights()
        count, size = len(gray), gray.shape[-1]
        self.start = _dome(mask, options.dome)
        widths = [size >> k for k in range(_LEVELS) if size >> k >= 4]
        self.levels = [torch.zeros(count, 1, width, width) for width in widths]
        self.code = torch.zeros(count, self.mean.shape[0])
        if coarse is not None:
            # The same level is twice as many pixels wide and deep here, and its unit sqrt(2) as large.
            for level, known in zip(self.levels[1:], coarse.levels, strict=False):
                level.copy_(known.detach() * 2**0.5)
            self.code.copy_(coarse.code.detach())
        for unknown in (*self.levels, self.code):
            unknown.requires_grad_(True)

    def run(self, steps: int) -> None:
        """Minimise by Adam, at a rate that falls to 0."""
        rate = self.options.rate
        optimiser = torch.optim.Adam([*self.levels, self.code], lr=rate, betas=(0.9, 0.99))
        for step in range(steps):
            for group in optimiser.param_groups:
                group["lr"] = rate * (1 - step / steps) ** 0.5
            optimiser.zero_grad()
            self.energy().sum().backward()  # type: ignore[no-untyped-call]
            optimiser.step()

    def answer(self) -> Intrinsic:
        """As it stands."""
        with torch.no_grad():
            depth = self.depth()
            return Intrinsic(normals_of_height(depth), depth, self.light(), self.energy())

    def depth(self) -> Tensor:
        """(B, 1, S, S)."""
        size = self.mask.shape[-1]
        total = self.start
        for level in self.levels:
            # A coarse level moves further than a fine one, and tilts less.
            unit = 0.25 * (size / level.shape[-1]) ** 0.5
            total = total + unit * functional.interpolate(
                level, size=(size, size), mode="bilinear", align_corners=False
            )
        return total

    def light(self) -> Tensor:
        """(B, 9)."""
        return self.mean + self.code @ self.root.T

    def energy(self) -> Tensor:
        """Of each image, (B,)."""
        options, depth = self.options, self.depth()
        normal = normals_of_height(depth)
        basis = sh_basis(normal, LIGHT_ORDER, dim=1)
        shade = torch.einsum("bkhw,bk->bhw", basis, self.light())[:, None]
        soft = functional.softplus(shade, beta=_SHARP)
        albedo = self.bright - (soft + options.dark).log()
        upright = normal[:, 2:].clamp_min(1e-3)
        weight = self.mask / self.mask.sum((1, 2, 3), keepdim=True)
        slant = (weight * -upright.log()).sum((1, 2, 3))
        level = (weight * (albedo - _LOG_HALF) ** 2).sum((1, 2, 3))
        outward, where = self.outline
        turned = (where * (1 - (normal[:, :2] * outward).sum(1, keepdim=True))).sum((1, 2, 3))
        return (
            options.edges * albedo_edges(albedo, self.mask)
            + options.entropy * albedo_entropy(albedo, self.mask, self.pairs)
            + options.level * level
            + options.bend * bending_energy(depth, self.mask)
            + options.front * slant
            + options.contour * turned
            + options.light * (self.code**2).mean(1)
        )


_LOG_HALF: Final = -0.6931


def normals_of_height(depth: Tensor) -> Tensor:
    """Unit normals (B, 3, S, S) of a depth map (B, 1, S, S): z toward the viewer, in pixels."""
    padded = functional.pad(depth, (1, 1, 1, 1), mode="replicate")
    right = (padded[..., 1:-1, 2:] - padded[..., 1:-1, :-2]) / 2
    down = (padded[..., 2:, 1:-1] - padded[..., :-2, 1:-1]) / 2
    return unit(torch.cat([-right, down, torch.ones_like(right)], 1))


def _dome(mask: Tensor, degrees: float) -> Tensor:
    """A paraboloid over the mask (B, 1, S, S) whose slant is ``degrees`` at the ends of its axes."""
    size = mask.shape[-1]
    place = torch.arange(size) + 0.5
    weight = mask / mask.sum((2, 3), keepdim=True)
    depth = torch.zeros_like(mask)
    for axis in (place[None, :], place[:, None]):
        middle = (weight * axis).sum((2, 3), keepdim=True)
        # An ellipse's half axis is twice the standard deviation along it.
        half = 2 * (weight * (axis - middle) ** 2).sum((2, 3), keepdim=True).sqrt().clamp_min(1)
        depth = depth - torch.tan(torch.deg2rad(torch.tensor(degrees))) * (axis - middle) ** 2 / (2 * half)
    return depth
