from __future__ import annotations

import gc

import numpy as np
import pytest

from sfsnet_dr.scene.faces.noise import RANK, NoiseBank, read_noise

GRID = np.stack(np.meshgrid(*[np.linspace(0.0, 2.0, 24)] * 3), axis=-1).reshape(-1, 3)


def test_fields_have_unit_variance_and_no_mean() -> None:
    fields = NoiseBank(GRID).draw(9.0, 8, np.random.default_rng(1))
    # 18 waves along each edge make some 6,000 cells, so that 0.013 is a standard deviation; 0.020 seen.
    assert np.abs(fields.mean(axis=0)).max() < 0.06
    np.testing.assert_allclose(fields.std(axis=0), 1.0, atol=0.04)


def test_fields_of_one_draw_are_uncorrelated() -> None:
    """Over 1000 persons at one point: they are orthogonal mixtures."""
    bank = NoiseBank(GRID[:64])
    values = np.stack([bank.draw(5.0, 3, np.random.default_rng(k))[0] for k in range(1000)])
    correlation = np.corrcoef(values.T)[np.triu_indices(3, 1)]
    assert np.abs(correlation).max() < 0.1  # three standard deviations of 1 / sqrt(1000)


@pytest.mark.parametrize("frequency", [2.0, 6.0])
def test_waves_lie_in_the_octave(frequency: float) -> None:
    """Spectrum along lines: a wave of the octave seen along a line is never shorter than its upper end."""
    samples, length = 256, 8.0
    line = np.zeros((samples, 3))
    line[:, 0] = np.linspace(0.0, length, samples, endpoint=False)
    starts = np.random.default_rng(3).uniform(0, 5, (60, 1, 3))
    power = np.zeros(samples // 2 + 1)
    for k, start in enumerate(starts):
        fields = read_noise((line + start).astype(np.float32), frequency, np.random.default_rng(k))
        windowed = fields * np.hanning(samples)[:, None]
        power += (np.abs(np.fft.rfft(windowed, axis=0)) ** 2).sum(axis=1)
    cycles = np.arange(len(power)) / length
    upper = frequency * 2**0.5
    # Linear interpolation between grid points leaks 0.03 % (seen) into shorter waves.
    assert power[cycles > upper + 0.3].sum() < 1e-3 * power.sum()
    assert power[cycles > 0.5 * frequency].sum() > 0.4 * power.sum()


def test_a_generator_gives_one_field() -> None:
    first, again = (NoiseBank(GRID[:100]).draw(4.0, 2, np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    other = NoiseBank(GRID[:100]).draw(4.0, 2, np.random.default_rng(8))
    assert np.abs(first - other).max() > 0.5


def test_every_draw_takes_as_many_numbers() -> None:
    rng, twin = np.random.default_rng(0), np.random.default_rng(0)
    NoiseBank(GRID[:10]).draw(3.0, 2, rng)
    twin.normal(size=(RANK, 2))
    assert rng.random() == twin.random()


def test_what_is_kept_for_a_head_goes_with_it() -> None:
    from sfsnet_dr.scene.faces.per_head_cache import cached_per_head
    from sfsnet_dr.scene.faces.regions import RegionWeights

    made: list[int] = []

    @cached_per_head
    def count(weights: RegionWeights) -> int:
        made.append(len(weights.neutral))
        return len(made)

    def head(size: int) -> RegionWeights:
        zero = np.zeros(size)
        return RegionWeights(np.zeros((size, 3)), *[zero] * 11)

    one, two = head(3), head(4)
    assert (count(one), count(two), count(one)) == (1, 2, 1)
    del one
    gc.collect()
    assert count(head(5)) == 3
    assert count(two) == 2
