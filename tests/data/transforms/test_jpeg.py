"""The model of JPEG against files by libjpeg."""

from __future__ import annotations

import io

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from PIL import Image
from skimage import data

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.transforms.jpeg import simulate_jpeg

Picture = NDArray[np.uint8]


def portrait() -> Picture:
    """130 x 151 pixels: no multiple of the blocks' size."""
    whole: Picture = data.astronaut()  # type: ignore[no-untyped-call]
    return whole[:130, 150:301]


def by_file(picture: Picture, quality: int) -> NDArray[np.float64]:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", quality=quality, subsampling=2)
    return np.asarray(Image.open(file), dtype=np.float64)


def by_model(picture: Picture, quality: int) -> NDArray[np.float64]:
    encoded = torch.from_numpy(np.moveaxis(picture, -1, 0)[None] / 255.0).float()
    return np.moveaxis(simulate_jpeg(encoded, quality)[0].double().numpy(), 0, -1) * 255


@pytest.mark.parametrize("quality", [10, 30, 50, 75, 90])
def test_the_loss_is_that_of_a_file(quality: int) -> None:
    picture = portrait()
    file, model = by_file(picture, quality), by_model(picture, quality)
    apart = np.sqrt(((file - model) ** 2).mean())
    loss = np.sqrt(((file - picture) ** 2).mean())
    # libjpeg's integer arithmetic rounds some coefficients the other way: 1.4 levels of 255 seen, times
    # 1.3, where the loss itself is 4 to 12.
    assert apart < 1.8
    assert apart < 0.4 * loss
    assert np.sqrt(((model - picture) ** 2).mean()) == pytest.approx(loss, rel=0.05)
    # The same loss in other places would be no good model: what is lost is the same.
    assert np.corrcoef((file - picture).ravel(), (model - picture).ravel())[0, 1] > 0.9


def test_lower_quality_loses_more() -> None:
    picture = portrait()
    losses = [np.abs(by_model(picture, q) - picture).mean() for q in (5, 25, 60, 95, 100)]
    assert losses == sorted(losses, reverse=True)


def test_even_grey_survives() -> None:
    grey = torch.full((2, 3, 20, 20), 128 / 255)
    torch.testing.assert_close(simulate_jpeg(grey, 50), grey, atol=1e-6, rtol=0)


def test_bad_input() -> None:
    with pytest.raises(InputError, match="quality"):
        simulate_jpeg(torch.zeros(1, 3, 8, 8), 0)
    with pytest.raises(InputError, match="encoded"):
        simulate_jpeg(torch.zeros(3, 8, 8), 50)
