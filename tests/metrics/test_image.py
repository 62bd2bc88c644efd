"""Image errors against values worked out by hand and scikit-image."""

from __future__ import annotations

import numpy as np
import pytest
from skimage import metrics as skimage_metrics

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.metrics.image import mae_8bit, psnr, rel_rmse, rmse_8bit


def _linear(units: float) -> float:
    """The linear value that sRGB shows as ``units`` of 255 (IEC 61966-2-1, upper piece)."""
    return float(((units / 255 + 0.055) / 1.055) ** 2.4)


def test_relative_rmse() -> None:
    reference = np.array([[[3.0, 4.0, 0.0]]])
    assert rel_rmse(reference * 1.1, reference) == pytest.approx(0.1)
    assert rel_rmse(reference + np.array([0, 0, 5]), reference) == pytest.approx(1)


def test_eight_bit_units() -> None:
    """Two pixels that are 6 and 8 units off: mean 7, root mean square sqrt 50."""
    reference = np.full((1, 2, 3), _linear(100))
    image = np.stack([np.full((1, 3), _linear(106)), np.full((1, 3), _linear(92))], axis=1)
    assert mae_8bit(image, reference) == pytest.approx(7, abs=1e-4)
    assert rmse_8bit(image, reference) == pytest.approx(np.sqrt(50), abs=1e-4)


def test_display_range_is_clipped() -> None:
    assert mae_8bit(np.full((2, 2, 3), 7.0), np.ones((2, 2, 3))) == 0
    assert mae_8bit(np.full((2, 2, 3), -1.0), np.ones((2, 2, 3))) == pytest.approx(255)


def test_psnr_equals_scikit_image_on_encoded_images() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.uniform(20, 255, (2, 16, 16, 3))
    linear_a, linear_b = (((x / 255 + 0.055) / 1.055) ** 2.4 for x in (a, b))
    expected = skimage_metrics.peak_signal_noise_ratio(b, a, data_range=255)  # type: ignore[no-untyped-call]
    assert psnr(linear_a, linear_b) == pytest.approx(expected, abs=1e-5)
    assert psnr(linear_a, linear_a) == np.inf


@pytest.mark.parametrize("metric", [rel_rmse, mae_8bit, rmse_8bit])
def test_masks_weigh_pixels(metric: object) -> None:
    assert callable(metric)
    rng = np.random.default_rng(1)
    image, reference = rng.uniform(size=(2, 5, 8, 8, 3))
    mask = np.zeros((5, 8, 8))
    mask[2, 3:6, 2:5] = 0.5
    inside = (slice(2, 3), slice(3, 6), slice(2, 5))
    assert metric(image, reference, mask) == pytest.approx(
        metric(image[inside], reference[inside]), rel=1e-12
    )


def test_bad_input_is_named() -> None:
    ones = np.ones((4, 4, 3))
    with pytest.raises(InputError, match=r"image: shape \(3, 4, 3\)"):
        rel_rmse(ones[:3], ones)
    with pytest.raises(InputError, match="reference: black inside"):
        rel_rmse(ones, ones * 0)
    with pytest.raises(InputError, match="mask: shape"):
        mae_8bit(ones, ones, np.ones((4, 4, 1)))
    with pytest.raises(InputError, match="mask: negative or no weight"):
        mae_8bit(ones, ones, np.zeros((4, 4)))
    with pytest.raises(InputError, match="image: NaN or inf"):
        rmse_8bit(ones * np.inf, ones)
