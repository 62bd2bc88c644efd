from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.transforms.camera import (
    READ_NOISE,
    PhotoEffects,
    PhotoOptions,
    frame_masks,
    sample_effects,
    simulate_photograph,
)

PLAIN = PhotoEffects(gain=np.ones(3), blur=0.0, noise=0.0, quality=None, grey=False, seed=0)


def image(size: int = 64) -> torch.Tensor:
    """A smooth linear picture within 0.1 to 0.7."""
    x = torch.linspace(0, 1, size)
    red = 0.2 + 0.4 * x[None, :] * x[:, None]
    return torch.stack([red, 0.6 * red + 0.1, 0.1 + 0.2 * x.expand(size, size)])[None]


def take(effects: PhotoEffects, picture: torch.Tensor | None = None) -> torch.Tensor:
    picture = image() if picture is None else picture
    return simulate_photograph(
        picture, torch.ones(1, 1, *picture.shape[-2:]), torch.zeros_like(picture), [effects]
    )


def test_no_effect_is_the_image() -> None:
    torch.testing.assert_close(take(PLAIN), image(), atol=0, rtol=0)


def test_gain_multiplies_and_white_clips() -> None:
    gain = np.array([1.2, 1.0, 2.0])
    expected = (image() * torch.tensor(gain, dtype=torch.float32)[:, None, None]).clamp(0, 1)
    torch.testing.assert_close(take(replace(PLAIN, gain=gain)), expected, atol=1e-7, rtol=0)
    assert take(replace(PLAIN, gain=np.full(3, 9.0))).max() == 1.0


def test_the_background_shows_where_the_face_is_not() -> None:
    coverage = torch.zeros(1, 1, 64, 64)
    coverage[..., :32] = 1
    behind = torch.full((1, 3, 64, 64), 0.5)
    got = simulate_photograph(image() * coverage, coverage, behind, [PLAIN])
    torch.testing.assert_close(got[..., 32:], behind[..., 32:])
    torch.testing.assert_close(got[..., :32], image()[..., :32])


def test_noise_grows_as_photons_and_amplifiers_have_it() -> None:
    for signal in (0.1, 0.6):
        flat = torch.full((1, 3, 100, 100), signal)
        got = take(replace(PLAIN, noise=0.02), flat)
        # Variance level^2 (signal + read noise); 30,000 samples give its root to 0.4 %, times 4.
        assert got.std().item() == pytest.approx(0.02 * (signal + READ_NOISE) ** 0.5, rel=0.016)
        assert got.mean().item() == pytest.approx(signal, abs=4e-4)
    first, again, other = (take(replace(PLAIN, noise=0.02, seed=seed)) for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_blur_has_its_width_and_keeps_the_light() -> None:
    point = torch.zeros(1, 3, 33, 33)
    point[..., 16, 16] = 1
    got = take(replace(PLAIN, blur=1.5), point)[0, 0].double()
    x = torch.arange(33) - 16
    assert got.sum().item() == pytest.approx(1.0, abs=1e-5)
    # Cut at 3.3 standard deviations, the kernel is 1.5 % narrower.
    assert (got.sum(0) * x**2).sum().sqrt().item() == pytest.approx(1.5, rel=0.015)
    torch.testing.assert_close(got, got.T, atol=1e-7, rtol=0)
    flat = torch.full((1, 3, 8, 8), 0.4)
    torch.testing.assert_close(take(replace(PLAIN, blur=2.0), flat), flat)  # the border repeats


def test_grey_is_luminance() -> None:
    got = take(replace(PLAIN, grey=True))
    expected = (image()[0].permute(1, 2, 0) @ torch.tensor(LUMINANCE, dtype=torch.float32))[None, None]
    torch.testing.assert_close(got, expected.expand(1, 3, -1, -1), atol=1e-6, rtol=0)


def test_jpeg_costs_detail_and_leaves_the_whole() -> None:
    noisy = image() + 0.05 * torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    got = take(replace(PLAIN, quality=30), noisy)
    assert got.mean().item() == pytest.approx(noisy.mean().item(), rel=0.01)
    assert 0.005 < (got - noisy).abs().mean() < 0.03


def test_every_image_has_its_own_effects() -> None:
    pictures = image().expand(2, -1, -1, -1)
    effects = [PLAIN, replace(PLAIN, gain=np.full(3, 0.5))]
    got = simulate_photograph(pictures, torch.ones(2, 1, 64, 64), torch.zeros_like(pictures), effects)
    torch.testing.assert_close(got[1], 0.5 * got[0])


def test_what_is_drawn() -> None:
    options = PhotoOptions(exposure=0.5, white_balance=0.2, jpeg=0.5, grayscale_prob=0.25)
    drawn = [sample_effects(np.random.default_rng(seed), options) for seed in range(400)]
    again = sample_effects(np.random.default_rng(7), options)
    np.testing.assert_array_equal(drawn[7].gain, again.gain)
    stops = np.log2([effect.gain for effect in drawn])
    assert np.abs(stops[:, 1]).max() <= 0.5
    assert stops[:, 0].std() > stops[:, 1].std()  # white balance is added to red and blue
    # Shares of 400: 4 standard deviations are 0.1.
    assert np.mean([effect.quality is not None for effect in drawn]) == pytest.approx(0.5, abs=0.1)
    assert np.mean([effect.grey for effect in drawn]) == pytest.approx(0.25, abs=0.1)
    assert {effect.quality for effect in drawn} - {None} <= set(range(50, 99))
    nothing = sample_effects(np.random.default_rng(0), PhotoOptions(0, 0, 0, 0, jpeg=0, grayscale_prob=0))
    torch.testing.assert_close(take(nothing), image(), atol=0, rtol=0)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"blur": -1.0}, "blur"),
        ({"grayscale_prob": 2.0}, "grayscale_prob"),
        ({"quality": (90, 10)}, "quality"),
    ],
)
def test_bad_options(values: dict[str, float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        PhotoOptions(**values)  # type: ignore[arg-type]


def test_shapes_that_do_not_fit() -> None:
    with pytest.raises(InputError, match="images"):
        simulate_photograph(image(), torch.ones(1, 1, 64, 64), torch.zeros(1, 3, 64, 64), [PLAIN, PLAIN])


def test_a_photograph_may_end_within_the_frame() -> None:
    effects = replace(PLAIN, frame=(0.25, 0.125, 0.75, 1.0))
    inside = frame_masks([effects, PLAIN], 64, 64)
    expected = torch.zeros(64, 64)
    expected[8:, 16:48] = 1
    assert torch.equal(inside[0, 0], expected)
    assert inside[1].min() == 1
    assert torch.equal(take(effects), image() * expected)


def test_a_share_of_photographs_is_cropped_and_the_rest_is_as_without() -> None:
    def draw(cropped: float) -> list[PhotoEffects]:
        options = PhotoOptions(crop_prob=cropped)
        return [sample_effects(np.random.default_rng(seed), options) for seed in range(400)]

    some, none = draw(0.5), draw(0.0)
    share = np.mean([effect.frame is not None for effect in some])
    assert share == pytest.approx(0.5, abs=0.1)  # four times the deviation of a share of 400
    assert all(effect.frame is None for effect in none)
    assert all(np.array_equal(a.gain, b.gain) and a.seed == b.seed for a, b in zip(some, none, strict=True))
    for effect in some:
        left, top, right, bottom = effect.frame or (0.0, 0.0, 1.0, 1.0)
        assert 0 <= left <= 0.27
        assert 0 <= top <= 0.26
        assert 0.73 <= right <= 1
        assert 0.78 <= bottom <= 1
