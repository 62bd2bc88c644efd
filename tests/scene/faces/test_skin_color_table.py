from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.scene.faces.skin_color import lightest_angle, melanin_for, skin_rgb, skin_table, typology_angle
from sfsnet_dr.scene.faces.skin_optics import skin_reflectance


def test_look_up_is_the_spectral_colour() -> None:
    rng = np.random.default_rng(2)
    melanin = np.exp(rng.uniform(np.log(0.004), np.log(0.5), 3000))
    blood = np.exp(rng.uniform(np.log(0.0012), np.log(0.07), 3000))
    saturation = rng.uniform(0.45, 0.9, 3000)
    found = skin_table(0.0083).look_up(melanin, blood, saturation)
    exact = skin_rgb(skin_reflectance(melanin, blood, saturation, 0.0083))
    # Linear interpolation across curved cells: 0.0025 at worst and 0.0005 on average seen.
    assert np.abs(found - exact).max() < 0.004
    assert np.abs(found - exact).mean() < 0.001


def test_values_off_the_table_take_its_end() -> None:
    table, half = skin_table(0.008), np.array([0.7])
    beyond = table.look_up(np.array([5.0]), np.array([0.5]), half)
    np.testing.assert_allclose(beyond, table.look_up(np.array([0.6]), np.array([0.08]), half))


@pytest.mark.parametrize("angle", [-50.0, -20.0, 0.0, 30.0, 45.0])
def test_melanin_is_found_for_a_tone(angle: float) -> None:
    melanin = melanin_for(angle, 0.006, 0.7, 0.008)
    reached = float(typology_angle(skin_rgb(skin_reflectance(melanin, 0.006, 0.7, 0.008))))
    assert reached == pytest.approx(angle, abs=0.1)  # 0.02 seen: linear in log melanin between 60 nodes


def test_less_blood_allows_lighter_skin() -> None:
    angles = [lightest_angle(blood, 0.7, 0.008) for blood in (0.002, 0.006, 0.02)]
    assert angles[0] > angles[1] > angles[2]
    assert angles[0] > 60.0
    assert melanin_for(80.0, 0.006, 0.7, 0.008) == pytest.approx(0.003)  # out of reach: the least
