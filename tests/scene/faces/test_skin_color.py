from __future__ import annotations

import colour
import numpy as np
import pytest

from sfsnet_dr.core.color import LUMINANCE, RGB_TO_XYZ, luminance, reflectance_weights
from sfsnet_dr.scene.faces.skin_color import GAMUT_FLOOR, clip_to_gamut, skin_rgb, typology_angle
from sfsnet_dr.scene.faces.skin_optics import WAVELENGTHS, skin_reflectance


def test_white_and_grey_spectra_are_neutral() -> None:
    np.testing.assert_allclose(skin_rgb(np.full(31, 0.35)), 0.35, rtol=1e-12)


def test_spectra_get_the_colour_that_colour_science_gives_them() -> None:
    """Through ``sd_to_XYZ``, which warns that it cuts the observer to 400 to 700 nm."""
    for melanin in (0.01, 0.06, 0.3):
        spectrum = skin_reflectance(melanin, 0.008, 0.7, 0.008)
        with pytest.warns(colour.utilities.ColourRuntimeWarning):
            xyz = colour.sd_to_XYZ(
                colour.SpectralDistribution(spectrum, WAVELENGTHS), illuminant=colour.SDS_ILLUMINANTS["D65"]
            )
        expected = np.linalg.solve(RGB_TO_XYZ, xyz / 100.0)
        # Its white is D65's chromaticity, ours the sum over the same steps: 0.0007 seen.
        np.testing.assert_allclose(skin_rgb(spectrum, None), expected, atol=2e-3)


def test_weights_of_finer_steps_agree() -> None:
    fine = np.arange(400.0, 700.5, 1.0)
    smooth = 0.3 + 0.2 * np.sin(WAVELENGTHS / 60.0)
    smooth_fine = 0.3 + 0.2 * np.sin(fine / 60.0)
    # The 10 nm sum against the 1 nm sum of a smooth spectrum: 5e-4 seen.
    np.testing.assert_allclose(
        smooth @ reflectance_weights(WAVELENGTHS), smooth_fine @ reflectance_weights(fine), atol=1.5e-3
    )


def test_gamut_mapping_keeps_luminance_and_colours_inside() -> None:
    rng = np.random.default_rng(0)
    colours = rng.uniform(-0.05, 0.6, (500, 3))
    colours = colours[colours @ LUMINANCE > GAMUT_FLOOR]
    mapped = clip_to_gamut(colours)
    np.testing.assert_allclose(luminance(mapped), luminance(colours), atol=1e-12)
    assert mapped.min() >= GAMUT_FLOOR
    inside = colours.min(axis=1) >= GAMUT_FLOOR
    np.testing.assert_allclose(mapped[inside], colours[inside], atol=1e-12)
    moved, original = mapped[~inside], colours[~inside]
    toward = (moved - luminance(moved)[:, None]) * (original - luminance(original)[:, None])
    assert (toward >= -1e-12).all()  # no channel crosses to the other side of grey: the hue stays


def test_a_colour_darker_than_the_floor_becomes_the_floor() -> None:
    np.testing.assert_allclose(clip_to_gamut([-0.01, 0.001, 0.0]), GAMUT_FLOOR)


def test_typology_angle_is_its_definition() -> None:
    linear = skin_rgb(skin_reflectance(0.02, 0.005, 0.7, 0.008))
    lab = colour.XYZ_to_Lab(RGB_TO_XYZ @ linear, [0.3127, 0.329])
    assert float(typology_angle(linear)) == pytest.approx(np.degrees(np.arctan((lab[0] - 50) / lab[2])))
