"""The protocol of methods that decompose faces, networks behind it, and the wide crop.

A network that was shown the middle of the frame answers for that. Chins and foreheads of large faces lie
beyond; for these it is shown the whole frame with as many pixels, where faces are smaller than it is used to.
The two answers meet on a rim. The second one's albedo is scaled to the first one's, for how a network shares
brightness between albedo and light differs a little between the two; light is that of the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor, nn

from sfsnet_dr.core.color_torch import linear_to_srgb, srgb_to_linear
from sfsnet_dr.core.conventions import FACE_SIZE, LIGHT_ORDER
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.pseudo_labels import Encoding
from sfsnet_dr.data.transforms.camera import metering_gain
from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.models.base import NetworkOutput
from sfsnet_dr.models.inference import load_model, predict, predict_with_flip_tta
from sfsnet_dr.render.shading_torch import shading, unit
from sfsnet_dr.sh.basis_torch import sh_basis

#: Pixels of the canonical frame over which one answer fades into the other, inside of the view.
BLEND_PX: Final = 6
#: Greatest factor between the two albedos that is believed.
_MOST: Final = 4.0


def needs_wide_crop(masks: Tensor, view: Crop) -> Tensor:
    """Which of some masks (B, 1, H, W) reach out of the view, (B,) of bool."""
    return ((masks > 0.5) & (view.coverage(masks.shape[-1]).to(masks.device) < 0.5)).flatten(1).any(1)


def blend_crops(near: NetworkOutput, wide: NetworkOutput, masks: Tensor, view: Crop) -> NetworkOutput:
    """The answer for the view, and around it the answer for the whole frame.

    Args:
        near: for the view, its maps spread over the frame, (B, 3, H, W).
        wide: the same for the whole frame.
        masks: (B, 1, H, W); the two albedos are compared on their pixels within the view.
        view: what ``near`` was found from.

    Returns:
        Unit normals and albedo; the light of ``near``.
    """
    share = _share(view, masks.shape[-1]).to(masks)
    both = masks * view.coverage(masks.shape[-1]).to(masks)
    sums = [(both * part.albedo).flatten(1).sum(1).clamp_min(1e-6) for part in (near, wide)]
    factor = (sums[0] / sums[1]).clamp(1 / _MOST, _MOST)[:, None, None, None]
    return NetworkOutput(
        unit(share * near.normal + (1 - share) * wide.normal),
        share * near.albedo + (1 - share) * factor * wide.albedo,
        near.light,
    )


def _share(view: Crop, pixels: int) -> Tensor:
    """Return (N, N): 1 within the view, 0 beyond it, falling over ``BLEND_PX`` pixels before its edges."""
    edge = view.crop / FACE_SIZE / 2
    place = ((torch.arange(pixels) + 0.5) / pixels - 0.5).abs()
    ramp = ((edge - place) * FACE_SIZE / BLEND_PX).clamp(0, 1)
    return ramp[:, None] * ramp[None, :]


#: Of skin, where nothing says how bright it is.
MEAN_ALBEDO: Final = 0.5


class Prediction(NamedTuple):
    """What a method says about a batch.

    Args:
        normal: unit vectors in the camera frame, (B, 3, H, W).
        albedo: linear, up to a factor for each image, (B, 3, H, W).
        light: order-2 shading coefficients, (B, 27).
        image: linear reconstruction, (B, 3, H, W).
        divided: whether the albedo is the image divided by the shading. The reconstruction is then the image
            itself by construction, and no error of it is worth telling.
    """

    normal: Tensor
    albedo: Tensor
    light: Tensor
    image: Tensor
    divided: bool = False


class Method(Protocol):
    """One method."""

    @property
    def name(self) -> str:
        """A short word for records and tables."""

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Prediction:
        """Take faces apart.

        Args:
            images: linear, in the canonical frame, (B, 3, 128, 128).
            masks: share of each pixel that is skin, (B, 1, 128, 128).
            subjects: whom they show; for methods that must not know the same person.
        """


@runtime_checkable
class PerImageSet(Protocol):
    """A method that knows something of each capture (a face in one pose under several lights) beforehand."""

    def of_capture(self, capture: str) -> Method:
        """The method for images of one capture."""


def method_for_image_set(method: Method, capture: str) -> Method:
    """What to call for images of a capture; most methods are the same for all."""
    return method.of_capture(capture) if isinstance(method, PerImageSet) else method


class NetworkMethod:
    """A trained network, at the size and with the form of values that it was trained with.

    Args:
        name: see ``Method``.
        weights: its file, or the name of a shipped network.
        once: see ``infer``.

    Raises:
        InputError: for unusable weights.
    """

    def __init__(self, name: str, weights: Path | str, *, once: bool = False) -> None:
        self.name, self.once = name, once
        self.trained = load_model(weights)

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Prediction:
        """See ``Method``."""
        trained = self.trained
        found, gain = infer(trained.model, images, masks, trained.crop, trained.encoding, once=self.once)
        normal, albedo, light = found
        image = albedo * shading(normal, light)
        if trained.encoding == "srgb":
            image, albedo = srgb_to_linear(image) / gain, srgb_to_linear(albedo.clamp_min(0))
        return Prediction(normal, albedo, light, image)


def infer(
    model: nn.Module, images: Tensor, masks: Tensor, view: Crop, values: Encoding, *, once: bool = False
) -> tuple[NetworkOutput, Tensor]:
    """A network's answer at the resolution of the images, and the gains that it saw them with.

    They are shown to it as ``view`` says, its maps are interpolated. Images whose mask reaches out of the
    view are shown to it whole as well, for what lies there (``whole_frame``). Images that are far darker or
    brighter than photographs are metered for it (``data.exposure``).

    Args:
        model: the network.
        images: linear, (B, 3, H, W), H = W.
        masks: (B, 1, H, W).
        view: what it was shown of the frame in training.
        values: what an image's numbers are to it.
        once: do not ask it for the mirror images too and take the mean: half the time.

    Returns:
        Unit normals, and albedo and light whose product is the image; where the network understands encoded
        values, it is the encoded image times the gain. And the gains (B, 1, 1, 1).

    Raises:
        InputError: if the images show the view with fewer pixels than the network was trained on.
    """
    gain = metering_gain(images, masks)
    metered = images * gain
    found = _spread(model, metered, view, values, once)
    rows = needs_wide_crop(masks, view)
    if rows.any():
        wide = _spread(model, metered[rows], view._replace(crop=FACE_SIZE), values, once)
        near = NetworkOutput(*(part[rows] for part in found))
        for part, whole in zip(found, blend_crops(near, wide, masks[rows], view), strict=True):
            part[rows] = whole
    light = found.light / gain[:, :, 0, 0] if values == "linear" else found.light
    return NetworkOutput(found.normal, found.albedo, light), gain


def _spread(model: nn.Module, images: Tensor, view: Crop, values: Encoding, once: bool) -> NetworkOutput:
    """Unit normals and albedo on the whole frame from a view of it; beyond the view the nearest answer."""
    try:
        small = view.apply(images).clamp(0, 1)
    except InputError as error:
        raise InputError(f"images: {error}, as the network was trained") from error
    answer = (predict if once else predict_with_flip_tta)(
        model, linear_to_srgb(small) if values == "srgb" else small
    )
    normal, albedo = (view.invert(part, images.shape[-1]) for part in (answer.normal, answer.albedo))
    return NetworkOutput(unit(normal), albedo, answer.light)


class FlatNormals:
    """Every normal toward the viewer; the albedo takes all that is in the image."""

    name = "flat"

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Prediction:
        """See ``Method``."""
        normal = torch.zeros_like(images)
        normal[:, 2] = 1
        return fit_light_and_albedo(normal, images, masks)


def fit_light_and_albedo(normal: Tensor, images: Tensor, masks: Tensor, ridge: float = 0.01) -> Prediction:
    """Light by least squares under a constant albedo, and the albedo that then explains each image.

    Args:
        normal: unit vectors, (B, 3, H, W).
        images: linear, (B, 3, H, W).
        masks: (B, 1, H, W); pixels that count.
        ridge: see ``fit_light_to_images``.
    """
    constant = torch.full_like(images[:, :1], MEAN_ALBEDO)
    return albedo_by_division(normal, fit_light_to_images(normal, constant, images, masks, ridge), images)


def fit_light_to_images(
    normal: Tensor, albedo: Tensor, images: Tensor, masks: Tensor, ridge: float = 0.01
) -> Tensor:
    """Light (B, 27) by least squares, for which albedo times shading is most like the images.

    Args:
        normal: unit vectors, (B, 3, H, W).
        albedo: the same for all colours, (B, 1, H, W).
        images: linear, (B, 3, H, W).
        masks: (B, 1, H, W); pixels that count.
        ridge: penalty on the coefficients, in shares of the mean square of the basis.
    """
    basis = albedo.double() * sh_basis(normal, LIGHT_ORDER, dim=1).double()
    weight = masks.double()
    gram = torch.einsum("bkhw,blhw->bkl", basis * weight, basis)
    right = torch.einsum("bkhw,bchw->bck", basis * weight, images.double())
    scale = gram.diagonal(dim1=1, dim2=2).mean(1)[:, None, None]
    gram = gram + (ridge * scale + 1e-9) * torch.eye(gram.shape[-1], dtype=gram.dtype)
    light: Tensor = torch.linalg.solve(gram[:, None], right[..., None])
    return light.reshape(len(images), -1).float()


def albedo_by_division(normal: Tensor, light: Tensor, images: Tensor) -> Prediction:
    """The albedo that explains images once normals and light are found: the image over the shading.

    Shading below a twentieth of the image's mean shading counts as that much: dark pixels say little.
    """
    shade = shading(normal, light)
    floor = 0.05 * shade.clamp_min(0).mean((1, 2, 3), keepdim=True) + 1e-6
    albedo = images / shade.clamp_min(0).maximum(floor)
    return Prediction(normal, albedo, light, albedo * shade, divided=True)
