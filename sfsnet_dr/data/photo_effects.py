"""From the linear image of a face to a photograph of it: background, lens, exposure, sensor, JPEG.

The steps have the order of a camera's. What they take is drawn first (``sample_effects``), so that a
photograph can be made again and its light label can follow: exposure and white balance multiply the light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from sfsnet_dr.base.checks import BadInput, check_shape
from sfsnet_dr.base.color import LUMINANCE
from sfsnet_dr.base.color_torch import linear_to_srgb, srgb_to_linear
from sfsnet_dr.data.augment import READ_NOISE
from sfsnet_dr.data.jpeg import compress


@dataclass(frozen=True)
class PhotoOptions:
    """How much photographs differ from the light that reached the camera.

    Attributes:
        exposure: greatest change either way, in stops.
        white_balance: standard deviation of the error of the red and the blue gain, in stops.
        blur: greatest standard deviation of the lens's blur, pixels; half of the images have none.
        noise: greatest standard deviation of sensor noise at signal 1.
        jpeg: share of images that went through a JPEG file.
        quality: range of its quality.
        grey: share of images without colour.

    Raises:
        BadInput: for values out of range.
    """

    exposure: float = 0.3
    white_balance: float = 0.1
    blur: float = 1.0
    noise: float = 0.02
    jpeg: float = 0.5
    quality: tuple[int, int] = (50, 98)
    grey: float = 0.1

    def __post_init__(self) -> None:
        for name in ("exposure", "white_balance", "blur", "noise"):
            if not getattr(self, name) >= 0:
                raise BadInput(f"{name}: {getattr(self, name)} found, 0 or more is needed")
        for name in ("jpeg", "grey"):
            if not 0 <= getattr(self, name) <= 1:
                raise BadInput(f"{name}: {getattr(self, name)} found, a probability from 0 to 1 is needed")
        if not 1 <= self.quality[0] <= self.quality[1] <= 100:
            raise BadInput(f"quality: {self.quality} found, two increasing numbers from 1 to 100 are needed")


@dataclass(frozen=True, eq=False)
class PhotoEffects:
    """What happens to one image.

    Attributes:
        gain: (3,) factor on the linear image, exposure times white balance. The image's light label has to be
            multiplied by it too.
        blur: standard deviation, pixels.
        noise: standard deviation at signal 1; variance grows linearly with the signal (shot noise) from
            ``augment.READ_NOISE`` of it at signal 0 (read noise).
        quality: of the JPEG file, or None.
        grey: whether the image has no colour: every channel is its luminance.
        seed: of the noise.
    """

    gain: NDArray[np.float64]
    blur: float
    noise: float
    quality: int | None
    grey: bool
    seed: int


def sample_effects(rng: np.random.Generator, options: PhotoOptions) -> PhotoEffects:
    """Draw the effects of one image."""
    stops = rng.uniform(-options.exposure, options.exposure) * np.ones(3)
    stops[[0, 2]] += rng.normal(0.0, options.white_balance, 2)
    blurred, blur = rng.random() < 0.5, rng.uniform(0.0, options.blur)
    noise = rng.uniform(0.0, options.noise)
    compressed, quality = rng.random() < options.jpeg, int(rng.integers(*options.quality, endpoint=True))
    grey, seed = rng.random() < options.grey, int(rng.integers(2**32))
    return PhotoEffects(
        gain=2.0**stops,
        blur=float(blur) if blurred else 0.0,
        noise=float(noise),
        quality=quality if compressed else None,
        grey=bool(grey),
        seed=seed,
    )


def photograph(images: Tensor, coverage: Tensor, behind: Tensor, effects: list[PhotoEffects]) -> Tensor:
    """Take photographs.

    Args:
        images: linear images (B, 3, H, W) of the faces alone, 0 where they are not.
        coverage: share of each pixel that the face covers, (B, 1, H, W).
        behind: linear background (B, 3, H, W) before exposure, as of ``augment.backgrounds``.
        effects: B of them.

    Returns:
        What a viewer of the picture decodes, linear, (B, 3, H, W) in [0, 1].

    Raises:
        BadInput: if shapes do not fit.
    """
    sizes = check_shape("images", images, "B 3 H W", B=len(effects))
    check_shape("coverage", coverage, "B 1 H W", **sizes)
    check_shape("behind", behind, "B 3 H W", **sizes)
    arriving = images.float() + (1 - coverage.float()) * behind.float()
    return torch.cat([_develop(arriving[k : k + 1], effect) for k, effect in enumerate(effects)])


def _develop(image: Tensor, effect: PhotoEffects) -> Tensor:
    image = _blurred(image, effect.blur) * image.new_tensor(effect.gain)[:, None, None]
    noise = np.random.default_rng(effect.seed).standard_normal(tuple(image.shape), dtype=np.float32)
    deviation = effect.noise * (image.clamp_min(0) + READ_NOISE).sqrt()
    image = (image + deviation * torch.from_numpy(noise)).clamp(0, 1)
    if effect.grey:
        image = torch.einsum("c,bchw->bhw", image.new_tensor(LUMINANCE), image)[:, None].expand(-1, 3, -1, -1)
    if effect.quality is not None:
        image = srgb_to_linear(compress(linear_to_srgb(image), effect.quality))
    return image


def _blurred(image: Tensor, deviation: float) -> Tensor:
    """Gaussian blur; the border repeats."""
    if deviation < 0.05:  # the neighbours' weights would be below float32's rounding
        return image
    reach = int(np.ceil(3 * deviation))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / deviation) ** 2)
    weights = torch.from_numpy(kernel / kernel.sum()).float()
    padded = functional.pad(image, (reach, reach, reach, reach), mode="replicate")
    across = functional.conv2d(padded, weights.expand(3, 1, 1, -1), groups=3)
    return functional.conv2d(across, weights[:, None].expand(3, 1, -1, -1), groups=3)
