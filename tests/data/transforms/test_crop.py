"""What a network is shown of the frame, and its answer brought back, against slices and other libraries."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.spheres import write_spheres
from scipy.ndimage import map_coordinates
from torch import Tensor, nn
from torch.nn import functional

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.dataset import load_faces
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.inference.methods import infer
from sfsnet_dr.models.base import NetworkOutput
from sfsnet_dr.models.inference import load_model
from sfsnet_dr.models.sfsnet import SfSNet
from sfsnet_dr.models.weights import save_weights


@pytest.fixture
def planes() -> Tensor:
    return torch.rand(2, 3, 32, 32, generator=torch.Generator().manual_seed(0))


def test_the_whole_frame_is_shown_by_means_of_blocks(planes: Tensor) -> None:
    # 1e-6: a few roundings of float32 sums of numbers up to 1.
    torch.testing.assert_close(Crop(8).apply(planes), functional.avg_pool2d(planes, 4), atol=1e-6, rtol=0)
    torch.testing.assert_close(Crop(32).apply(planes), planes, atol=0, rtol=0)


@pytest.mark.parametrize(("size", "crop", "finer", "block"), [(16, 96, 2, 3), (8, 80, 2, 5), (20, 80, 1, 1)])
def test_pixels_are_means_over_the_squares_that_they_cover(
    planes: Tensor, size: int, crop: int, finer: int, block: int
) -> None:
    """Where a pixel ends inside another: on a grid so fine that all borders lie on it."""
    margin = (32 - 32 * crop // 128) // 2
    middle = planes[..., margin : 32 - margin, margin : 32 - margin]
    fine = middle.repeat_interleave(finer, -1).repeat_interleave(finer, -2)
    expected = functional.avg_pool2d(fine, block)
    torch.testing.assert_close(Crop(size, crop).apply(planes), expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("view", [Crop(16), Crop(16, 96), Crop(10, 44)])
def test_an_answer_is_interpolated_onto_the_frame(view: Crop) -> None:
    answer = torch.rand(1, 1, view.size, view.size, generator=torch.Generator().manual_seed(1))
    begin, step = 32 * (1 - view.crop / 128) / 2, 32 * view.crop / 128 / view.size
    places = (np.arange(32) + 0.5 - begin) / step - 0.5
    grid = np.meshgrid(places, places, indexing="ij")
    expected = map_coordinates(answer[0, 0].numpy(), grid, order=1, mode="nearest")
    np.testing.assert_allclose(view.invert(answer, 32)[0, 0].numpy(), expected, atol=1e-6)
    if view.crop == 128:
        grown = functional.interpolate(answer, (32, 32), mode="bilinear", align_corners=False)
        torch.testing.assert_close(view.invert(answer, 32), grown, atol=1e-6, rtol=0)


def test_covered_is_the_share_that_is_shown() -> None:
    covered = Crop(8, 72).coverage(16)  # 9 of 16 pixels: from 3.5 to 12.5
    assert covered[8, :].tolist() == [0.0] * 3 + [0.5] + [1.0] * 8 + [0.5] + [0.0] * 3
    assert float(covered.sum()) == pytest.approx(81, abs=1e-5)
    assert float(covered[3, 3]) == 0.25
    assert bool((Crop(8).coverage(16) == 1).all())


def test_bundles_are_cropped_alike(tmp_path: Path) -> None:
    folder = write_spheres(tmp_path / "spheres", 2)
    whole, middle = load_faces(folder), load_faces(folder, Crop(12, 96))
    assert torch.equal(middle.directional, whole.directional[..., 2:14, 2:14])
    assert torch.equal(middle.mask, whole.mask[..., 2:14, 2:14])
    prints = {load_faces(folder, view).fingerprint for view in (None, Crop(12, 96), Crop(12, 112), Crop(12))}
    assert len(prints) == 4


class Places(nn.Module):
    """Answers with what it sees."""

    def forward(self, image: Tensor) -> NetworkOutput:
        normal = torch.zeros_like(image)
        normal[:, 2] = 1
        return NetworkOutput(normal, image, torch.zeros(len(image), 27))


def test_a_network_answers_for_what_it_was_shown() -> None:
    """Albedo that is the image comes back where it was; beyond the view, where no face is, the nearest."""
    ramp = torch.linspace(0.2, 0.8, 128)[None, None, :, None].expand(1, 3, 128, 128)
    view = Crop(48, 96)
    mask = (view.coverage(128) == 1).float()[None, None]
    found, gain = infer(Places(), ramp, mask, view, "linear", once=True)
    seen = found.albedo[0, 0, :, 64] / gain[0, 0, 0, 0]
    inside = slice(17, 111)  # half a pixel of the view less at each end
    torch.testing.assert_close(seen[inside], ramp[0, 0, inside, 64], atol=1e-5, rtol=0)
    assert bool((seen[:17] == seen[0]).all())
    assert bool((seen[111:] == seen[-1]).all())


def test_weights_tell_what_they_were_shown(tmp_path: Path) -> None:
    def weights(name: str, data: dict[str, int]) -> Path:
        path = tmp_path / f"{name}.safetensors"
        save_weights(path, SfSNet(4), {"recipe": {"data": data}})
        return path

    assert load_model(weights("a", {"size": 64, "crop": 96})).crop == Crop(64, 96)
    assert load_model(weights("b", {"size": 64})).crop == Crop(64, 128)
    with pytest.raises(InputError, match=r"trained on 48 of the frame's 128 pixels shown with 64"):
        load_model(weights("c", {"size": 64, "crop": 48}))


def test_what_does_not_fit_is_told() -> None:
    with pytest.raises(
        InputError, match=r"16 x 16 pixels found, a square of 43 or more is needed to show 96"
    ):
        Crop(32, 96).apply(torch.zeros(16, 16))
    with pytest.raises(InputError, match=r"16 x 12 pixels found"):
        Crop(8).apply(torch.zeros(16, 12))
    with pytest.raises(InputError, match=r"crop: 200 found, 8 to 128 allowed"):
        Augmentation(size=64, crop=200)
    with pytest.raises(InputError, match=r"crop: 96 found without size"):
        Augmentation(crop=96)
