"""What a network says of chins and foreheads beyond its view, asked with networks whose answers are known."""

from __future__ import annotations

import numpy as np
import torch
from data.transforms.test_crop import Places
from torch import Tensor

from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.inference.decompose import run_network
from sfsnet_dr.inference.methods import blend_crops, infer, needs_wide_crop
from sfsnet_dr.inference.photograph import Photograph
from sfsnet_dr.models.base import NetworkOutput

VIEW = Crop(48, 96)


class Dims(Places):
    """Answers with what it sees, half of it the second time, a third the third time."""

    asked = 0

    def forward(self, image: Tensor) -> NetworkOutput:
        self.asked += 1
        return super().forward(image / self.asked)


def ramps(count: int = 1) -> Tensor:
    """Images whose values rise evenly downward, as interpolation keeps them."""
    return torch.linspace(0.2, 0.8, 128)[None, None, :, None].expand(count, 3, 128, 128).contiguous()


def a_mask(inside: bool) -> Tensor:
    return (VIEW.coverage(128) == 1).float()[None, None] if inside else torch.ones(1, 1, 128, 128)


def test_the_second_answer_continues_the_first() -> None:
    """The wide view's albedo is half as bright here, and is brought to the other's scale."""
    network = Dims()
    found, gain = infer(network, ramps(), a_mask(inside=False), VIEW, "linear", once=True)
    assert network.asked == 2
    seen = found.albedo[0, 0, :, 64] / gain[0, 0, 0, 0]
    inside = slice(2, 126)  # half a pixel of the wide view less at each end: 4/3 pixels
    # 1.4e-4 measured: the two views' means of the pixels of their edges, which set the factor. Twice that.
    torch.testing.assert_close(seen[inside], ramps()[0, 0, inside, 64], atol=3e-4, rtol=0)


def test_faces_within_the_view_are_asked_for_once_and_left_alone() -> None:
    masks = torch.cat([a_mask(inside=True), a_mask(inside=False)])
    assert needs_wide_crop(masks, VIEW).tolist() == [False, True]
    network = Dims()
    alone, _ = infer(network, ramps(), masks[:1], VIEW, "linear", once=True)
    assert network.asked == 1
    both, _ = infer(Dims(), ramps(2), masks, VIEW, "linear", once=True)
    assert torch.equal(both.albedo[0], alone.albedo[0])
    assert not torch.equal(both.albedo[1], both.albedo[0])


def test_a_network_that_was_shown_all_is_asked_once() -> None:
    network = Dims()
    infer(network, ramps(), a_mask(inside=False), Crop(64), "linear", once=True)
    assert network.asked == 1


def test_answers_fade_on_a_rim_of_six_pixels() -> None:
    """Normals that point up, and to the viewer further out: their mean by shares, of length one."""
    near, wide = torch.zeros(1, 3, 128, 128), torch.zeros(1, 3, 128, 128)
    near[:, 1], wide[:, 2] = 1, 1
    grey = torch.full((1, 3, 128, 128), 0.5)
    light = torch.arange(27.0)[None]
    found = blend_crops(
        NetworkOutput(near, grey, light), NetworkOutput(wide, grey, 2 * light), a_mask(inside=False), VIEW
    )
    assert torch.equal(found.light, light)
    # The view ends at 16; centres of pixels lie half a pixel further in, and the rim is six wide.
    share = np.clip((np.arange(128) + 0.5 - 16) / 6, 0, 1)
    share = np.minimum(share, share[::-1])
    expected = np.stack([np.zeros(128), share, 1 - share]) / np.hypot(share, 1 - share)
    np.testing.assert_allclose(found.normal[0, :, :, 64].numpy(), expected, atol=1e-6)
    np.testing.assert_allclose(found.normal[0, :, 64, :].numpy(), expected, atol=1e-6)
    torch.testing.assert_close(found.albedo, grey)


def test_an_albedo_of_nothing_scales_nothing_to_infinity() -> None:
    flat = torch.zeros(1, 3, 128, 128)
    flat[:, 2] = 1
    grey = NetworkOutput(flat, torch.full_like(flat, 0.5), torch.zeros(1, 27))
    black = NetworkOutput(flat, torch.zeros_like(flat), torch.zeros(1, 27))
    assert float(blend_crops(grey, black, a_mask(inside=False), VIEW).albedo.max()) == 0.5
    faint = NetworkOutput(flat, torch.full_like(flat, 0.001), torch.zeros(1, 27))
    corner = blend_crops(grey, faint, a_mask(inside=False), VIEW).albedo[0, 0, 0, 0]
    assert 0.0039 < float(corner) < 0.0041  # four times at most


def test_a_face_keeps_its_mask_beyond_the_view() -> None:
    picture = Photograph("ramp", np.moveaxis(ramps()[0].numpy(), 0, -1), np.full((128, 128), 0.7, np.float32))
    [face] = run_network(Places(), [picture], view=VIEW)
    np.testing.assert_array_equal(face.mask, picture.mask)
