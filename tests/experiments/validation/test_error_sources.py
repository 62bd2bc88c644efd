"""Errors split by cause: exact sums, offsetting causes, and no noise in any of it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sfsnet_dr.experiments.validation.error_sources import CAUSES, ErrorStep, decompose_error
from sfsnet_dr.experiments.validation.references import IndependentPair

MASK = np.ones((40, 40))


def twice(image: NDArray[np.float64]) -> IndependentPair:
    return IndependentPair(image, image)


def test_causes_that_do_not_overlap_share_by_their_squares() -> None:
    truth, first, second = np.ones((40, 40, 3)), np.zeros((40, 40, 3)), np.zeros((40, 40, 3))
    first[:20], second[20:] = 0.3, -0.1
    middle = truth + second
    steps = [
        ErrorStep("truncation", twice(middle + first), twice(middle)),
        ErrorStep("gloss", twice(middle), twice(truth)),
    ]
    parts = decompose_error(steps, MASK)
    assert parts["truncation"].size == pytest.approx(0.3 / np.sqrt(2))
    assert parts["gloss"].size == pytest.approx(0.1 / np.sqrt(2))
    assert parts["truncation"].share == pytest.approx(0.9)
    assert parts["gloss"].share == pytest.approx(0.1)
    assert set(parts) == set(CAUSES)
    assert sum(part.share for part in parts.values()) == pytest.approx(1.0)


def test_a_cause_that_offsets_others_has_a_negative_share() -> None:
    truth = np.ones((40, 40, 3))
    steps = [
        ErrorStep("visibility", twice(truth * 1.1), twice(truth * 0.95)),
        ErrorStep("interreflection", twice(truth * 0.95), twice(truth)),
    ]
    parts = decompose_error(steps, MASK)
    assert parts["visibility"].share == pytest.approx(1.5)
    assert parts["interreflection"].share == pytest.approx(-0.5)
    assert parts["visibility"].size == pytest.approx(0.15)


def test_noise_of_the_levels_stays_out_and_noise_of_the_model_is_told_apart() -> None:
    rng = np.random.default_rng(0)

    def noisy(image: NDArray[np.float64]) -> IndependentPair:
        return IndependentPair(*(image + 0.2 * rng.normal(size=image.shape) for _ in range(2)))

    truth, mask = np.ones((160, 160, 3)), np.ones((160, 160))
    own = 0.05 * rng.normal(size=truth.shape)
    direct = noisy(truth * 0.9)
    steps = [
        ErrorStep("truncation", twice(truth * 0.96 + own), direct),
        ErrorStep("interreflection", direct, noisy(truth)),
    ]
    parts = decompose_error(steps, mask, noise=0.05**2)
    # Products of two noises of 0.2 average over 76,800 values to 0.2^2 / sqrt(76800) = 1.5e-4: of 0.06^2 that
    # is 4 %, of the size 2 %; three times that. With the noise left in, both sizes would be 0.28 and more.
    assert parts["truncation"].size == pytest.approx(0.06, rel=0.06)
    assert parts["interreflection"].size == pytest.approx(0.1, rel=0.06)
    assert parts["noise"].size == pytest.approx(0.05, rel=1e-3)  # the truth it is divided by has noise
    assert sum(part.share for part in parts.values()) == pytest.approx(1.0)


def test_an_image_without_error_has_no_shares() -> None:
    truth = np.ones((40, 40, 3))
    assert all(
        part.share == 0 and part.size == 0
        for part in decompose_error([ErrorStep("gloss", twice(truth), twice(truth))], MASK).values()
    )
