from __future__ import annotations

import colour
import numpy as np
import pytest
from numpy.typing import NDArray

from sfsnet_dr.core.color import (
    LUMINANCE,
    RGB_TO_XYZ,
    blackbody_tint,
    delta_e_2000,
    linear_to_srgb,
    luminance,
    srgb_to_linear,
)
from sfsnet_dr.core.errors import InputError


def test_srgb_curve_by_the_standard() -> None:
    """IEC 61966-2-1 in its own words, on both pieces."""
    encoded = np.array([0.0, 0.02, 0.04, 0.05, 0.5, 1.0])
    low, high = encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(srgb_to_linear(encoded), np.where(encoded <= 0.04045, low, high), rtol=1e-12)
    assert srgb_to_linear(0.5) == pytest.approx(0.2140411, abs=1e-7)


def test_srgb_there_and_back() -> None:
    linear = np.concatenate([np.linspace(-0.5, 2, 301)])
    # The standard's two thresholds are rounded, so the pieces meet to 1e-7 only.
    np.testing.assert_allclose(srgb_to_linear(linear_to_srgb(linear)), linear, atol=1e-6)


def test_nothing_is_clipped() -> None:
    assert srgb_to_linear(-0.1292) == pytest.approx(-0.01)
    assert linear_to_srgb(4.0) > 1.8


def test_primaries_are_rec_709() -> None:
    published = colour.RGB_COLOURSPACES["ITU-R BT.709"].matrix_RGB_to_XYZ
    np.testing.assert_allclose(RGB_TO_XYZ, published, atol=1e-4)  # the published matrix has four digits
    np.testing.assert_allclose(LUMINANCE, [0.2126, 0.7152, 0.0722], atol=5e-5)
    np.testing.assert_allclose(luminance([[1, 1, 1], [0, 2, 0]]), [1, 2 * LUMINANCE[1]])


def linear_of_lab(lab: list[float]) -> NDArray[np.float64]:
    """CIE Lab to linear RGB, written out here so that the test does not lean on what it tests."""
    fy = (lab[0] + 16) / 116
    f = np.array([fy + lab[1] / 500, fy, fy - lab[2] / 200])
    relative = np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29))
    white = np.array([0.3127 / 0.3290, 1, (1 - 0.3127 - 0.3290) / 0.3290])
    linear: NDArray[np.float64] = np.linalg.solve(RGB_TO_XYZ, relative * white)
    return linear


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ([50.0, 2.6772, -79.7751], [50.0, 0.0, -82.7485], 2.0425),
        ([50.0, 2.5, 0.0], [73.0, 25.0, -18.0], 27.1492),
        ([60.2574, -34.0099, 36.2677], [60.4626, -34.1751, 39.4387], 1.2644),
        ([2.0776, 0.0795, -1.1350], [0.9033, -0.0636, -0.5514], 0.9082),
    ],
)
def test_delta_e_of_the_published_pairs(first: list[float], second: list[float], expected: float) -> None:
    """Sharma, Wu and Dalal, "The CIEDE2000 color-difference formula", 2005, table 1."""
    found = delta_e_2000(linear_of_lab(first), linear_of_lab(second))
    assert found == pytest.approx(expected, abs=1e-4)  # the table's four digits


def test_delta_e_keeps_the_shape() -> None:
    grey = np.full((4, 5, 3), 0.2)
    np.testing.assert_allclose(delta_e_2000(grey, grey), np.zeros((4, 5)), atol=1e-12)


@pytest.mark.parametrize("kelvin", [2000, 2800, 4000, 4001, 6500, 10000])
def test_black_body_is_plancks(kelvin: float) -> None:
    """Planck's law under the colour matching functions. The cubic fits were seen within 0.27 %, times 2."""
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    xyz = colour.sd_blackbody(kelvin, observer.shape).values @ observer.values
    rgb = np.maximum(np.linalg.solve(RGB_TO_XYZ, xyz / xyz[1]), 0)
    np.testing.assert_allclose(
        blackbody_tint(kelvin), rgb / (rgb @ LUMINANCE), atol=0.006 * (rgb / (rgb @ LUMINANCE)).max()
    )
    assert blackbody_tint(kelvin) @ LUMINANCE == pytest.approx(1)


def test_bad_input() -> None:
    with pytest.raises(InputError, match="colour temperature: 1000 K found, 1667 to 25000"):
        blackbody_tint(1000)
    with pytest.raises(InputError, match=r"linear_b: shape \(2,\) found"):
        delta_e_2000(np.zeros(3), np.zeros(2))
