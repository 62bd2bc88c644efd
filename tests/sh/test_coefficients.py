from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.sh.coefficients import Radiance, Shading


def random_values(order: int = 2) -> NDArray[np.float64]:
    return np.random.default_rng(5).normal(size=((order + 1) ** 2, 3))


def test_uniform_light_of_radiance_1_shades_to_1() -> None:
    values = np.zeros((9, 3))
    values[0] = np.sqrt(4 * np.pi)
    light = Radiance(values)
    np.testing.assert_allclose(light.evaluate([0.6, 0.0, 0.8]), 1.0, rtol=1e-15)
    np.testing.assert_allclose(
        light.to_shading().evaluate([[0.6, 0.0, 0.8], [0.0, -1.0, 0.0]]), 1.0, rtol=1e-15
    )


def test_bands_are_weighted_1_2_3rds_and_1_4th() -> None:
    values = random_values()
    weights = np.array([1] + [2 / 3] * 3 + [1 / 4] * 5)[:, None]
    np.testing.assert_allclose(Radiance(values).to_shading().values, weights * values, rtol=1e-15)


def test_shading_and_back() -> None:
    values = random_values()
    np.testing.assert_allclose(Radiance(values).to_shading().to_radiance().values, values, rtol=1e-14)


def test_the_way_back_ends_at_order_2() -> None:
    with pytest.raises(InputError, match="order 3 found, at most 2"):
        Radiance(random_values(3)).to_shading().to_radiance()


def test_flat_is_red_then_green_then_blue() -> None:
    light = Shading.from_flat(np.arange(27.0))
    np.testing.assert_array_equal(light.values[:, 0], np.arange(9))
    np.testing.assert_array_equal(light.values[:, 2], np.arange(18, 27))
    np.testing.assert_array_equal(light.flat(), np.arange(27))


def test_truncate_keeps_the_first_bands() -> None:
    light = Radiance(random_values(4))
    assert light.order == 4
    np.testing.assert_array_equal(light.truncate(1).values, light.values[:4])
    with pytest.raises(InputError, match="order: 5 found, 0 to 4 allowed"):
        light.truncate(5)


def test_lights_add_and_scale() -> None:
    light = Radiance(random_values())
    np.testing.assert_allclose((light + light * 2).values, 3 * light.values)
    np.testing.assert_allclose((light * [1, 0, 2]).values, light.values * [1, 0, 2])


def test_the_two_forms_do_not_mix() -> None:
    radiance = Radiance(random_values())
    with pytest.raises(TypeError, match=r"Radiance \+ Shading"):
        radiance + radiance.to_shading()  # type: ignore[operator]
    with pytest.raises(TypeError, match=r"Shading \* Radiance"):
        radiance.to_shading() * radiance
    with pytest.raises(InputError, match="orders 2 and 3"):
        radiance + Radiance(random_values(3))


@pytest.mark.parametrize("shape", [(9,), (9, 4), (8, 3), (3, 9)])
def test_wrong_shape(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="found"):
        Radiance(np.zeros(shape))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_not_finite(bad: float) -> None:
    values = random_values()
    values[3, 1] = bad
    with pytest.raises(InputError, match="Shading: NaN or inf found"):
        Shading(values)


def test_values_do_not_change_behind_its_back() -> None:
    values = random_values()
    light = Radiance(values)
    values[0] = 9
    assert light.values[0, 0] != 9
    with pytest.raises(ValueError, match="read-only"):
        light.values[0] = 1
