from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.sh.kernel import band_of, check_order, clamped_cosine, order_of


def test_closed_form_is_the_integral_of_the_cosine_over_the_upper_hemisphere() -> None:
    """A_l is 2 pi times the integral of mu P_l(mu) over 0..1, to degree 15 exact with 8 Gauss points."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    mu, weights = (nodes + 1) / 2, weights / 2
    for band, found in enumerate(clamped_cosine(12)):
        legendre = np.polynomial.legendre.Legendre.basis(band)(mu)
        expected = 2 * np.pi * np.sum(weights * mu * legendre)
        assert found == pytest.approx(expected, abs=1e-14)  # rounding of 8 terms of size 1


def test_first_bands_are_those_of_the_literature() -> None:
    published = [np.pi, 2 * np.pi / 3, np.pi / 4, 0, -np.pi / 24, 0, np.pi / 64, 0, -np.pi / 128]
    np.testing.assert_allclose(clamped_cosine(8), published, rtol=1e-15)


def test_bands_count_2l_plus_1_functions() -> None:
    assert band_of(2).tolist() == [0, 1, 1, 1, 2, 2, 2, 2, 2]
    assert len(band_of(8)) == 81


def test_order_of_inverts_the_count() -> None:
    assert [order_of((n + 1) ** 2) for n in range(9)] == list(range(9))


@pytest.mark.parametrize("count", [-1, 0, 2, 8, 10, 100])
def test_order_of_refuses_other_counts(count: int) -> None:
    with pytest.raises(InputError, match=f"{count} found, one of 1, 4, 9"):
        order_of(count)


@pytest.mark.parametrize("order", [-1, 9])
def test_order_out_of_range(order: int) -> None:
    with pytest.raises(InputError, match=f"order: {order} found, 0 to 8 allowed"):
        check_order(order)
