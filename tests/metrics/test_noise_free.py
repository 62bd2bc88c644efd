"""Noise-free comparison with noisy references, on images whose bias and noise are known."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.metrics.noise_free import bias_squared, relative_rmse

Array = npt.NDArray[np.float64]
SIZE = 64


def _references(seed: int, noise: float = 0.3) -> tuple[Array, Array, Array]:
    """A smooth truth of mean square about 1, and two noisy renders of it."""
    rng = np.random.default_rng(seed)
    wave = np.sin(np.linspace(0, 3, SIZE))
    truth = 0.9 + 0.3 * wave[:, None, None] * wave[None, :, None] * np.array([1, 0.5, 0.2])
    first, second = (truth + noise * rng.standard_normal(truth.shape) for _ in range(2))
    return truth, first, second


def _everywhere() -> Array:
    return np.ones((SIZE, SIZE))


def test_the_noise_of_the_references_drops_out() -> None:
    """A bias of 0.05 under noise of 0.3: the plain squared difference is 37 times too large."""
    found, naive = [], []
    for seed in range(30):
        truth, first, second = _references(seed)
        found.append(bias_squared(truth + 0.05, first, second, _everywhere()))
        naive.append(bias_squared(truth + 0.05, first, first, _everywhere()))
    # Spread of one estimate: products of noise 0.09 / sqrt(12288) and 2 x 0.05 x 0.3 / sqrt(2 x 12288):
    # 8.3e-4; of the mean of 30: 1.5e-4; four of them.
    assert np.mean(found) == pytest.approx(0.05**2, abs=6e-4)
    assert np.mean(naive) == pytest.approx(0.05**2 + 0.3**2, rel=0.05)


def test_without_noise_it_is_the_mean_square() -> None:
    rng = np.random.default_rng(0)
    image, truth = rng.uniform(size=(2, 9, 7, 3))
    mask = rng.uniform(size=(9, 7))
    expected = np.average((image - truth) ** 2, weights=np.repeat(mask[..., None], 3, axis=2))
    assert bias_squared(image, truth, truth, mask) == pytest.approx(expected, rel=1e-13)
    result = relative_rmse(image, truth, truth, mask, block=2)
    power = np.average(truth**2, weights=np.repeat(mask[..., None], 3, axis=2))
    assert result.value == pytest.approx(np.sqrt(expected / power), rel=1e-13)
    assert result.bias_squared == pytest.approx(expected, rel=1e-13)
    assert result.low < result.value < result.high


def test_the_mask_leaves_pixels_out() -> None:
    truth, first, second = _references(0)
    mask = _everywhere()
    mask[:10] = 0
    spoiled = truth + 0.05
    spoiled[:10] += 1000
    assert bias_squared(spoiled, first, second, mask) == bias_squared(truth + 0.05, first, second, mask)


def test_interval_covers_the_truth() -> None:
    """A relative error of 10 %, 60 pairs of references: about 95 % of the intervals contain it."""
    truth, _, _ = _references(0)
    image = truth * 1.1
    covered = 0
    for seed in range(60):
        _, first, second = _references(seed)
        result = relative_rmse(image, first, second, _everywhere(), seed=seed, draws=400)
        covered += result.low <= 0.1 <= result.high
    # Binomial of 60 at 95 %: fewer than 51 has a chance of 0.3 %.
    assert covered >= 51


def test_no_error_gives_an_interval_at_zero() -> None:
    truth, first, second = _references(1)
    result = relative_rmse(truth, first, second, _everywhere())
    assert result.low == 0
    assert result.high < 0.06  # sqrt(2 x 8.3e-4) is 0.041


def test_same_seed_same_interval() -> None:
    truth, first, second = _references(2)
    runs = [relative_rmse(truth * 1.1, first, second, _everywhere(), seed=s) for s in (5, 5, 6)]
    assert runs[0] == runs[1] != runs[2]


def test_bad_input_is_named() -> None:
    truth, first, second = _references(3)
    mask = _everywhere()
    with pytest.raises(InputError, match="second: shape"):
        bias_squared(truth, first, second[:5], mask)
    with pytest.raises(InputError, match="mask: shape"):
        bias_squared(truth, first, second, mask[..., None])
    with pytest.raises(InputError, match="mask: negative or no weight"):
        bias_squared(truth, first, second, mask * 0)
    with pytest.raises(InputError, match="first: NaN or inf"):
        bias_squared(truth, first * np.nan, second, mask)
    with pytest.raises(InputError, match="reference: mean square 0"):
        relative_rmse(truth, first * 0, second, mask)
    one_block = mask * 0
    one_block[:4, :4] = 1
    with pytest.raises(InputError, match="mask: 1 block"):
        relative_rmse(truth, first, second, one_block)
