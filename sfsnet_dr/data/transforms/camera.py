"""A camera model: exposure, white balance, blur, noise, JPEG and crop; and metering for networks.

The steps have the order of a camera's. What they take is drawn first (``sample_effects``), so that a
photograph can be made again and its light label can follow: exposure and white balance multiply the light.

A camera meters the whole picture; a database with fixed lamps does not meter at all, and a face lit from the
side is then ten times darker than anything in training. Scaling linear light changes neither normals nor
albedo, and the light's coefficients follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.color_torch import linear_to_srgb, srgb_to_linear
from sfsnet_dr.core.config import added_field
from sfsnet_dr.core.errors import InputError, check_shape
from sfsnet_dr.data.transforms.jpeg import simulate_jpeg

#: Share of white's signal that is added to the signal before shot noise is drawn: the read noise.
READ_NOISE: Final = 0.02

#: Where a photograph may end within the canonical frame: greatest depth from the left, top, right and bottom,
#: in shares of the frame. Databases of cropped faces keep little more than brows, cheeks and mouth.
DEEPEST_CROP: Final = np.array([0.27, 0.26, 0.27, 0.22])

#: Blur, pixels, below which the neighbours' weights are smaller than float32's rounding.
_SHARP: Final = 0.05


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
        grayscale_prob: share of images without colour.
        crop_prob: share of images that end within the frame, as tightly cropped photographs do; what lies
            beyond is black.

    Raises:
        InputError: for values out of range.
    """

    RENAMED: ClassVar[dict[str, str]] = {"grey": "grayscale_prob", "cropped": "crop_prob"}

    exposure: float = 0.3
    white_balance: float = 0.1
    blur: float = 1.0
    noise: float = 0.02
    jpeg: float = 0.5
    quality: tuple[int, int] = (50, 98)
    grayscale_prob: float = 0.1
    crop_prob: float = added_field(0.0)

    def __post_init__(self) -> None:
        for name in ("exposure", "white_balance", "blur", "noise"):
            if not getattr(self, name) >= 0:
                raise InputError(f"{name}: {getattr(self, name)} found, 0 or more is needed")
        for name in ("jpeg", "grayscale_prob", "crop_prob"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name}: {getattr(self, name)} found, a probability from 0 to 1 is needed")
        if not 1 <= self.quality[0] <= self.quality[1] <= 100:
            raise InputError(
                f"quality: {self.quality} found, two increasing numbers from 1 to 100 are needed"
            )


@dataclass(frozen=True, eq=False)
class PhotoEffects:
    """What happens to one image.

    Attributes:
        gain: (3,) factor on the linear image, exposure times white balance. The image's light label has to be
            multiplied by it too.
        blur: standard deviation, pixels.
        noise: standard deviation at signal 1; variance grows linearly with the signal (shot noise) from
            ``READ_NOISE`` of it at signal 0 (read noise).
        quality: of the JPEG file, or None.
        grey: whether the image has no colour: every channel is its luminance.
        seed: of the noise.
        frame: first and last (exclusive) column and row that the photograph has, as shares (left, top, right,
            bottom) of the frame; None for all.
    """

    gain: NDArray[np.float64]
    blur: float
    noise: float
    quality: int | None
    grey: bool
    seed: int
    frame: tuple[float, float, float, float] | None = None


def sample_effects(rng: np.random.Generator, options: PhotoOptions) -> PhotoEffects:
    """Draw the effects of one image."""
    stops = rng.uniform(-options.exposure, options.exposure) * np.ones(3)
    stops[[0, 2]] += rng.normal(0.0, options.white_balance, 2)
    blurred, blur = rng.random() < 0.5, rng.uniform(0.0, options.blur)
    noise = rng.uniform(0.0, options.noise)
    compressed, quality = rng.random() < options.jpeg, int(rng.integers(*options.quality, endpoint=True))
    grey, seed = rng.random() < options.grayscale_prob, int(rng.integers(2**32))
    frame = _sample_frame(rng, options.crop_prob) if options.crop_prob else None
    return PhotoEffects(
        gain=2.0**stops,
        blur=float(blur) if blurred else 0.0,
        noise=float(noise),
        quality=quality if compressed else None,
        grey=bool(grey),
        seed=seed,
        frame=frame,
    )


def _sample_frame(rng: np.random.Generator, share: float) -> tuple[float, float, float, float] | None:
    """Where a photograph ends: half of those that do are cropped tightly, the others at some sides."""
    chosen, tight = rng.random() < share, rng.random() < 0.5
    depth, sides = rng.random(4), rng.random(4) < 0.5
    shares = 0.5 + 0.5 * depth if tight else depth * sides
    left, top, right, bottom = shares * DEEPEST_CROP
    return (left, top, 1 - right, 1 - bottom) if chosen else None


def simulate_photograph(
    images: Tensor, coverage: Tensor, behind: Tensor, effects: Sequence[PhotoEffects]
) -> Tensor:
    """Take photographs.

    Args:
        images: linear images (B, 3, H, W) of the faces alone, 0 where they are not, on any device.
        coverage: share of each pixel that the face covers, (B, 1, H, W).
        behind: linear background (B, 3, H, W) before exposure, as of ``augment.backgrounds``.
        effects: B of them.

    Returns:
        What a viewer of the picture decodes, linear, (B, 3, H, W) in [0, 1].

    Raises:
        InputError: if shapes do not fit.
    """
    sizes = check_shape("images", images, "B 3 H W", B=len(effects))
    check_shape("coverage", coverage, "B 1 H W", **sizes)
    check_shape("behind", behind, "B 3 H W", **sizes)
    arriving = images.float() + (1 - coverage.float()) * behind.float()
    gains = arriving.new_tensor(np.array([effect.gain for effect in effects]))
    signal = _blurred(arriving, [effect.blur for effect in effects]) * gains[:, :, None, None]
    developed = _noisy(signal, effects).clamp_(0, 1)
    grey = _chosen(developed, [effect.grey for effect in effects])
    if len(grey):
        weights = developed.new_tensor(LUMINANCE)[:, None, None]
        developed[grey] = (developed[grey] * weights).sum(1, keepdim=True).expand(-1, 3, -1, -1)
    for k, effect in enumerate(effects):
        if effect.frame is not None:
            developed[k] = _framed(developed[k], effect.frame)
    filed = _chosen(developed, [effect.quality is not None for effect in effects])
    if len(filed):
        qualities = [effect.quality for effect in effects if effect.quality is not None]
        developed[filed] = srgb_to_linear(simulate_jpeg(linear_to_srgb(developed[filed]), qualities))
    return developed


def frame_masks(effects: Sequence[PhotoEffects], height: int, width: int) -> Tensor:
    """1 where photographs have pixels and 0 beyond their borders, (B, 1, H, W)."""
    inside = torch.ones(len(effects), 1, height, width)
    for k, effect in enumerate(effects):
        if effect.frame is not None:
            inside[k] = _framed(inside[k], effect.frame)
    return inside


def _framed(image: Tensor, frame: tuple[float, float, float, float]) -> Tensor:
    """An image (C, H, W) that ends where ``frame`` says."""
    height, width = image.shape[-2:]
    left, right = round(frame[0] * width), round(frame[2] * width)
    top, bottom = round(frame[1] * height), round(frame[3] * height)
    black = torch.zeros_like(image)
    black[:, top:bottom, left:right] = image[:, top:bottom, left:right]
    return black


def _chosen(images: Tensor, wanted: Sequence[bool]) -> Tensor:
    """Numbers of the images that something happens to."""
    return torch.tensor(
        [k for k, value in enumerate(wanted) if value], device=images.device, dtype=torch.int64
    )


def _noisy(signal: Tensor, effects: Sequence[PhotoEffects]) -> Tensor:
    """Each image's noise is drawn from its own seed, so that it does not depend on the others."""
    noise = torch.zeros_like(signal)
    for k, effect in enumerate(effects):
        if effect.noise > 0:
            generator = torch.Generator(signal.device).manual_seed(effect.seed)
            noise[k].normal_(0.0, effect.noise, generator=generator)
    return signal + noise.mul_((signal.clamp_min(0) + READ_NOISE).sqrt_())


def _blurred(images: Tensor, deviations: Sequence[float]) -> Tensor:
    """Gaussian blur, each image by its own standard deviation, cut at 3 of it; the border repeats."""
    chosen = _chosen(images, [deviation >= _SHARP for deviation in deviations])
    if not len(chosen):
        return images
    widths = np.array([deviation for deviation in deviations if deviation >= _SHARP])[:, None]
    reach = int(np.ceil(3 * widths.max()))
    places = np.arange(-reach, reach + 1)
    kernels = np.where(abs(places) <= np.ceil(3 * widths), np.exp(-0.5 * (places / widths) ** 2), 0.0)
    weights = images.new_tensor(kernels / kernels.sum(axis=1, keepdims=True))
    soft = _smoothed(_smoothed(images[chosen], weights, -1), weights, -2)
    return images.index_copy(0, chosen, soft)


def _smoothed(images: Tensor, weights: Tensor, axis: int) -> Tensor:
    """Images (B, 3, H, W) along one axis by kernels (B, N): shifted and added, which is the quickest here."""
    reach, length = weights.shape[1] // 2, images.shape[axis]
    sides = (reach, reach, 0, 0) if axis == -1 else (0, 0, reach, reach)
    padded = functional.pad(images, sides, mode="replicate")
    total = torch.zeros_like(images)
    for k in range(weights.shape[1]):
        total.addcmul_(padded.narrow(axis, k, length), weights[:, k, None, None, None])
    return total


#: Mean linear luminance of a face's pixels that is left as it is. Four in five of 300 photographs lie within;
#: their median is 0.30, their 5th and 95th percentiles are 0.13 and 0.46.
USUAL: Final = (0.1, 0.4)


def metering_gain(images: Tensor, masks: Tensor) -> Tensor:
    """Factors that bring faces into the usual range of exposures.

    Args:
        images: linear Rec. 709, (B, 3, H, W).
        masks: share of each pixel that is skin, (B, 1, H, W).

    Returns:
        (B, 1, 1, 1); 1 for faces within ``USUAL`` and for images without a face or without light.
    """
    weights = images.new_tensor(LUMINANCE)[:, None, None]
    luminance = (images * weights).sum(1, keepdim=True)
    total = masks.sum((1, 2, 3), keepdim=True)
    mean = (luminance * masks).sum((1, 2, 3), keepdim=True) / total.clamp_min(1e-6)
    gain = mean.clamp(*USUAL) / mean.clamp_min(1e-6)
    return gain.where((total > 0) & (mean > 1e-6), gain.new_ones(()))
